"""Where the firmware and its data lie: beside this file when installed, else in the checkout."""

import os
import sys
from pathlib import Path

_HERE = Path(__file__).resolve().parent
_INSTALLED = (_HERE / "firmware").is_dir()
_ROOT = _HERE if _INSTALLED else _HERE.parent

TOOLS = _HERE
FIRMWARE = _ROOT / "firmware"
BOARDS = _ROOT / "boards"
OWN_BOARDS = Path() if _INSTALLED else BOARDS  # where a new one is written
CACHE = None if _INSTALLED else _ROOT / "build" / "cache"  # see compiling/kept.py
EXAMPLES = _ROOT / "examples"
CONVERSATIONS = (_HERE if _INSTALLED else _ROOT / "host_tests") / "conversations"
COMPILED = _HERE / "compiled"  # the firmware, in an installed package only
STANDINS = _HERE / "sim" / "standins"  # for the modules that only a board has


def use_firmware(fast: bool = True) -> None:
    """Make the firmware importable here. Call it before the first import of a firmware module.

    fast leaves out the checks of viper arithmetic; UGRBL_VIPER in the environment overrules it.
    """
    for folder in (str(FIRMWARE), str(STANDINS)):
        if folder in sys.path:
            sys.path.remove(folder)
        sys.path.insert(0, folder)

    import micropython

    if "UGRBL_VIPER" not in os.environ:
        micropython.VIPER = "fast" if fast else "checked"
