"""Replays cases of one file in a process of its own, under either Python.

python replay_main.py FILE BOARD [INDEX...]  — prints one line of JSON per case
as soon as it is done. FILE holds a list of cases or one motion record.
"""

import gc
import json
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import ModuleType


def set_path() -> None:
    """Find firmware, boards and simulator; under CPython the stand-ins as well. UGRBL_FIRMWARE:
    what MicroPython runs in place of the sources (compiling/folder.place())."""
    here = sys.argv[0].rsplit("/", 1)[0] if "/" in sys.argv[0] else "."
    tools = here + "/.."
    try:
        os.stat(tools + "/firmware")
        root = tools  # installed
    except OSError:
        root = tools + "/.."
    # In place of this folder, whose modules would hide the firmware's.
    sys.path[0:1] = [os.getenv("UGRBL_FIRMWARE") or root + "/firmware"]
    if sys.implementation.name == "cpython":
        sys.path.insert(0, here + "/standins")
    sys.path.append(root)
    sys.path.append(tools)


def load_board(name: str) -> "ModuleType":
    """The module of a board by its name."""
    board: "ModuleType" = getattr(__import__("boards." + name), name)
    return board


def main() -> None:
    """Replay what the command line asks for."""
    set_path()
    replay = __import__("sim.replay").replay.replay

    board = load_board(sys.argv[2])
    with open(sys.argv[1]) as file:
        cases = json.load(file)
    if isinstance(cases, dict):
        cases = [cases]
    for index in [int(text) for text in sys.argv[3:]] or range(len(cases)):
        result = replay(cases[index], board)
        result["index"] = index
        print(json.dumps(result))
        if hasattr(sys.stdout, "flush"):
            sys.stdout.flush()
        gc.collect()


if __name__ == "__main__":
    main()
