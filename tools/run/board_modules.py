"""Modules of boards, and how completely they exist on the desktop: for the user's own Python."""

import time
import traceback
from types import ModuleType

from .. import paths

# Modules of MicroPython 1.28, built in and frozen, on both kinds of chip and on only one of them.
ON_BOARDS = frozenset(
    "_asyncio _onewire _thread aioble array asyncio binascii bluetooth builtins cmath collections "
    "cryptolib deflate dht ds18x20 errno framebuf gc hashlib heapq io json machine marshal math "
    "micropython mip neopixel network ntptime onewire openamp os platform random re requests "
    "select socket ssl string struct sys time tls uctypes urequests vfs weakref webrepl "
    "websocket".split()
)
ON_ONE_CHIP = {
    "pio": frozenset("_rp2 lwip rp2".split()),
    "esp": frozenset(
        "_espnow aioespnow apa106 btree esp esp32 espnow logging senml umqtt upysh".split()
    ),
}
# In these, CPython with complete() has everything boards have, so a missing name is a typing
# mistake.
_WHOLE = frozenset(
    "array binascii cmath collections errno hashlib heapq io json math random re struct "
    "time".split()
)
_PARTLY = ON_BOARDS.union(*ON_ONE_CHIP.values()) - _WHOLE
# These are partly modelled, so a name that they do not have may exist on a board.
_STANDINS = ("machine", "peripherals", "rp2", "esp32")
_TICKS = 1 << 30  # ticks wrap around at this number


def is_lacking(fault: "BaseException | None") -> bool:
    """Return whether a fault is caused by something that boards have and the simulator does not: a
    module, an attribute of one or of its objects, or what a stand-in for one raises."""
    if isinstance(fault, ImportError):
        return (fault.name or "").partition(".")[0] in _PARTLY
    if isinstance(fault, AttributeError) and fault.obj is not None:
        owner = fault.obj if isinstance(fault.obj, type | ModuleType) else type(fault.obj)
        name = owner.__name__ if isinstance(owner, ModuleType) else owner.__module__
        return name in (_PARTLY if isinstance(owner, ModuleType) else _STANDINS)
    frames = traceback.extract_tb(fault.__traceback__) if fault else []
    files = [str(paths.STANDINS / f"{name}.py") for name in _STANDINS]
    return bool(frames) and frames[-1].filename in files


def complete() -> None:
    """Add MicroPython's functions to `time`. Ticks are those of the wall clock."""
    added = {
        "ticks_ms": lambda: time.monotonic_ns() // 1_000_000 % _TICKS,
        "ticks_us": lambda: time.monotonic_ns() // 1_000 % _TICKS,
        "ticks_cpu": lambda: time.monotonic_ns() // 1_000 % _TICKS,
        "ticks_add": lambda ticks, delta: (ticks + delta) % _TICKS,
        "ticks_diff": lambda a, b: (a - b + _TICKS // 2) % _TICKS - _TICKS // 2,
        "sleep_ms": lambda ms: time.sleep(max(0, ms) / 1000),
        "sleep_us": lambda us: time.sleep(max(0, us) / 1_000_000),
    }
    for name, function in added.items():
        vars(time).setdefault(name, function)
