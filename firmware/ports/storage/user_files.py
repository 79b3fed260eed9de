"""User files: Python modules that the user has put on the board, next to the firmware."""

import os


def modules(name: str) -> "tuple[str, ...]":
    """Return the names to import for `name`: its own if NAME.py exists, NAME.X for each X.py of
    the folder NAME, sorted; none if neither exists. name: may be a path, whose slashes the
    returned names keep."""
    folder, _, last = name.rpartition("/")
    files = os.listdir(folder or ".") if name else ()
    if last + ".py" in files:
        return (name,)
    if last not in files:
        if last + ".whole" not in files:
            return ()
        os.rename(name + ".whole", name)  # `ugrbl custom push` stopped between two renamings
    modules_in_folder = sorted(os.listdir(name))
    suffix = ".py"
    return tuple(
        [name + "." + file[: -len(suffix)] for file in modules_in_folder if file.endswith(suffix)]
    )
