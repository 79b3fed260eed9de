"""Replay recorded cases in a process of its own, under CPython or MicroPython.

Reads one case per line, as JSON {"board": NAME, "case": {...}}, and prints the observation as a
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
    """Make firmware, boards and simulator importable; under CPython the stand-ins too.
    UGRBL_FIRMWARE, of the environment: a folder of compiled firmware, which MicroPython runs
    instead of the sources (compiling/folder.place())."""
    here = sys.argv[0].rsplit("/", 1)[0] if "/" in sys.argv[0] else "."  # tools/sim
    tools = here + "/.."
    try:
        os.stat(tools + "/firmware")
        root = tools  # installed: the firmware is inside the package
    except OSError:
        root = tools + "/.."
    # Replaces this folder, whose modules would hide the firmware's.
    sys.path[0:1] = [os.getenv("UGRBL_FIRMWARE") or root + "/firmware"]
    if sys.implementation.name == "cpython":
        sys.path.insert(0, here + "/standins")
    sys.path.append(root)
    sys.path.append(tools)


def load_board(name: str) -> "ModuleType":
    """Return the module of a board by its name."""
    board: "ModuleType" = getattr(__import__("boards." + name), name)
    return board


def main() -> None:
    """Replay the cases on standard input."""
    set_path()
    replay = __import__("sim.replay").replay.replay
    if hasattr(gc, "freeze"):
        gc.freeze()  # so that CPython's collector does not scan all modules for each case
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(replay(asked["case"], load_board(asked["board"]))))
        if hasattr(sys.stdout, "flush"):
            sys.stdout.flush()


if __name__ == "__main__":
    main()
