"""Replays recorded cases in a process of its own, under either Python.

Reads one case per line, as JSON {"board": NAME, "case": {...}}, and prints what was observed as a
line of JSON, until its input ends.
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
    """Replay what standard input asks for."""
    set_path()
    replay = __import__("sim.replay").replay.replay
    if hasattr(gc, "freeze"):
        gc.freeze()  # CPython need not look through all modules again for each case
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(replay(asked["case"], load_board(asked["board"]))))
        if hasattr(sys.stdout, "flush"):
            sys.stdout.flush()


if __name__ == "__main__":
    main()
