"""User files: the Python that its user has put on the board, beside the firmware."""

import os


def modules(name: str) -> "tuple[str, ...]":
    """The module NAME.py, or those of the folder NAME; none where neither is there."""
    folder, _, last = name.rpartition("/")
    there = os.listdir(folder or ".") if name else ()
    if last + ".py" in there:
        return (name,)
    if last not in there:
        if last + ".whole" not in there:
            return ()
        os.rename(name + ".whole", name)  # `ugrbl custom push` was cut between two renamings
    files = sorted(os.listdir(name))
    return tuple([name + "." + file[:-3] for file in files if file.endswith(".py")])
