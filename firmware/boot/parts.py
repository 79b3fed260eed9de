"""Parts: chooses what the board has, makes the machine of it, and forgets how that was done.

A board forgets this module too once the machine is there: it has no use for it then.
"""

import gc
import sys

from micropython import const
from ports.supervisor import Supervisor

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import ModuleType

    from interfaces import BoardLink, BoardPort, StepEngine
    from talk.controller import Controller

    Parts = tuple[Controller, BoardLink, BoardPort, StepEngine, Supervisor]

# Nothing of ours is there, and to look for each module of MicroPython's there takes 3 ms.
_USERS = "/lib"

# Stuck for so long, the chip starts anew: flash is written in less, the longest of all work.
_WATCHDOG_MS = const(5000)

# The main loop turns within so long, or the machine is stopped. A collection takes 30 ms at the
# most; who has more to do, in main.py say, reads the link in between.
_LOOP_MS = const(250)

# What $I says where Ctrl-X is not heard before the main loop reads; `ugrbl doctor` knows it.
_SLOW_RESET = " slow-reset"

# Methods that make objects, or begin so, in a class or a module; and what is made also later.
MAKERS = ("__init__", "connect")
MAKER = "_make_"  # keep-prefix: methods are looked for by it
MADE_AGAIN = ("Modal",)


def build(stay: "Callable[[BoardLink | None, Exception], None]") -> "Parts | None":
    """Make the machine of board.py; None where there cannot be one, or the REPL is asked for.

    stay: called with the link, if there is one, and what is wrong where there cannot be one.
    """
    link: "BoardLink | None" = None
    port: "BoardPort | None" = None
    path = sys.path[:]
    try:
        sys.path[:] = [folder for folder in path if folder != _USERS]
        import board

        link = _link(getattr(board, "LINK", "usb"))
        engine, port = _hardware(board, link)
        if port.held(getattr(board, "REPL_PIN", None)):
            link.close()
            return None
        watch = Supervisor(link, engine, port, getattr(board, "LOOP_MS", _LOOP_MS))
        machine = _build(board, link, port, engine, watch)
    except Exception as fault:
        if port:
            port.safe()
        stay(link, fault)
        return None
    finally:
        sys.path[:] = path
    if board.ENGINE == "pio":
        from pio import stack

        stack.paint()
        machine.commands.health = stack.report
    feed = port.watch(getattr(board, "WATCHDOG_MS", _WATCHDOG_MS))
    parts = machine, link, port, engine, watch
    _forget_makers(parts)
    for owner in (machine, machine.interpreter, engine, link):
        _forget_makers(owner.__dict__.values())
    del sys.modules["board"]
    watch.start(feed, machine.drive.reset)
    return parts


def _link(kind: str) -> "BoardLink":
    if kind == "uart":
        from ports.uart_link import UartLink

        return UartLink()
    if kind == "usb":
        from ports.usb_link import UsbLink

        usb = UsbLink()
        forget("ports.usb_ring")  # it has found what there is to find
        return usb
    raise ValueError("LINK %s is not one there is" % kind)


def _hardware(board: "ModuleType", link: "BoardLink") -> "tuple[StepEngine, BoardPort]":
    """Engine and port; the engine's buffers are the first large things in memory."""
    from ports import pin_check

    from boot import guests

    pin_check.check(board, guests.pins(board))
    forget("ports.pin_check")
    from boot import needs

    needs.check(board.ENGINE)
    forget("boot.needs")
    if board.ENGINE == "pio":
        from pio.engine import PioEngine
        from pio.pins import GpioPort

        hold_us = getattr(board, "DIR_HOLD_US", 2)
        setup_us = getattr(board, "DIR_SETUP_US", 5)
        engine = PioEngine(board.STEP, board.DIR, hold_us, setup_us)
        port = GpioPort(board)
        engine.on_fault = port.kill
        _forget_programs()
        return engine, port
    from boot import parts_esp

    made = parts_esp.make(board, link)
    forget("boot.parts_esp")
    return made


def _forget_programs() -> None:
    """What made the PIO's programs, MicroPython's own part too: nearly 2 kB."""
    forget("rp2")
    forget("pio.programs")


def _build(
    board: "ModuleType",
    link: "BoardLink",
    port: "BoardPort",
    engine: "StepEngine",
    watch: Supervisor,
) -> "Controller":
    from ports.flash_store import FlashStore

    gc.collect()
    from boot import wiring

    store = FlashStore()
    machine = wiring.build(board, link, port, engine, store)
    forget("boot.wiring")  # with these, 5 kB that nobody needs any more
    forget("boot.options")
    forget("boot.guests")
    if link.is_slow:
        machine.report.identity += _SLOW_RESET
    written = getattr(engine, "flash_written", None)
    store.before, store.after = machine.around_saves(watch.allow, written)
    link.attach(machine.at_rest, machine.welcome)
    gc.collect()
    return machine


# Memory


def forget(module: str) -> None:
    """Let go of a module, which its folder knows too."""
    sys.modules.pop(module, None)
    folder, _, name = module.rpartition(".")
    if folder:
        sys.modules[folder].__dict__.pop(name, None)


def _forget_makers(parts: "Iterable[object]") -> None:
    """Let go of what has made these: there is one of each, for good."""
    for part in parts:
        _forget_maker(type(part))


def _forget_maker(kind: type) -> None:
    """Of a class of ours, of those that it is made of, and of its module."""
    if "__module__" in kind.__dict__ and kind.__name__ not in MADE_AGAIN:
        for thing in (kind, sys.modules[kind.__module__]):
            for name in list(thing.__dict__):
                if name in MAKERS or name.startswith(MAKER):
                    setattr(thing, name, None)  # what is deleted stays in memory, in its place
        for base in kind.__bases__:
            _forget_maker(base)
