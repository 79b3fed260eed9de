"""User files: Python modules that the user has put on the board, next to the firmware."""

import os


def modules(name: str) -> "tuple[str, ...]":
    """Return the module NAME.py, or the modules of the folder NAME; none if neither exists."""
    folder, _, last = name.rpartition("/")
    there = os.listdir(folder or ".") if name else ()
    if last + ".py" in there:
        return (name,)
    if last not in there:
        if last + ".whole" not in there:
            return ()
        os.rename(name + ".whole", name)  # `ugrbl custom push` stopped between two renamings
    files = sorted(os.listdir(name))
    return tuple([name + "." + file[:-3] for file in files if file.endswith(".py")])
