# mypy: ignore-errors
"""The firmware's modules as they are on the board: each a file, or all of a package in one."""


def module(package, name):
    """The module of a package, or the package, where `ugrbl build` has put them together."""
    try:
        return getattr(__import__(package + "." + name), name)
    except ImportError:
        return __import__(package)
