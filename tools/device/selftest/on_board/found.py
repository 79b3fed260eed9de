# mypy: ignore-errors
"""The firmware's modules on the board, by package and name: `import` binds the package alone."""


def module(package, name):
    """The module of a package: `storage.flash_store` of `ports`."""
    found = __import__(package + "." + name)
    for part in name.split("."):
        found = getattr(found, part)
    return found
