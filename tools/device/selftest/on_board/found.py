# mypy: ignore-errors
"""The firmware's modules as they are on the board: each a file, or all of a package in one."""


def module(package, name):
    """The module of a package, or the package, where `ugrbl build` has put them together."""
    try:
        found = __import__(package + "." + name)
        for part in name.split("."):
            found = getattr(found, part)
        return found
    except ImportError:
        return __import__(package)
