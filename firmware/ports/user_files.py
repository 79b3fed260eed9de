"""User files: the Python that its user has put on the board, beside the firmware."""

import os


def modules(name: str) -> "tuple[str, ...]":
    """The module NAME.py, or those of the folder NAME; none where neither is there."""
    if not name:
        return ()
    try:
        os.stat(name + ".py")
        return (name,)
    except OSError:
        pass
    try:
        files = sorted(os.listdir(name))
    except OSError:
        return ()
    return tuple([name + "." + file[:-3] for file in files if file.endswith(".py")])
