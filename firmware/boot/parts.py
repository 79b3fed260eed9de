"""Parts: chooses what the board has, makes the machine of it, and forgets how that was done.

The tables _ENGINES and _LINKS have all that is to be known of either; the tools read them too. A
board forgets this module once the machine is there: it has no use for it then.
"""

import sys

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable, Iterable
    from types import ModuleType

    from interfaces import BoardLink, BoardPort, StepEngine
    from ports.supervisor import Supervisor
    from talk.controller import Controller

    # And what can wait until somebody has been welcomed: called once, and let go of.
    Later = list[Callable[[], None]]
    Parts = tuple[Controller, BoardLink, BoardPort, StepEngine, Supervisor, Later]
    # Engine, pins, and who watches the chip's health once the machine is there, for $I+.
    Hardware = tuple[StepEngine, BoardPort, Callable[[], Callable[[], str]] | None]
    Oldest = tuple[str, tuple[int, int], str]
    Engine = tuple[
        Callable[[ModuleType, BoardLink], Hardware],
        tuple[str, ...],
        tuple[str, ...],
        int,
        tuple[Oldest, ...],
    ]

# Nothing of ours is there, and to look for each module of MicroPython's there takes 3 ms.
_USERS = "/lib"

# Stuck for so long, the chip starts anew: flash is written in less, the longest of all work.
_WATCHDOG_MS = const(5000)

# The main loop turns within so long, or the machine is stopped. A collection takes 30 ms at the
# most; who has more to do, in main.py say, reads the link in between.
_LOOP_MS = const(250)

# What $I says where Ctrl-X is not heard before the main loop reads; `ugrbl doctor` knows it.
_SLOW_RESET = " slow-reset"

# Extras that do no more than make a machine, a kilobyte each.
_MAKING = ("extras.kinematics.nonlinear", "extras.kinematics.motor_matrix")

# What makes objects, or has that in its name, in a class or a module; and what extras do then.
MAKERS = ("__init__", "connect", "prepare", "install")
MAKER = "_make_"


# Engines and links: a build takes the imports of those that the board file names.


def pio(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """State machines of a PIO."""
    from pio import stack
    from pio.engine import PioEngine
    from pio.pins import GpioPort

    option = board.__dict__.get  # getattr() would keep the names for good
    hold_us, setup_us = option("DIR_HOLD_US", 2), option("DIR_SETUP_US", 5)
    pins = board.STEP, board.DIR, hold_us, setup_us
    if option("TOOL", "spindle") == "laser":
        from pio.beam import BeamEngine

        engine: PioEngine = BeamEngine(*pins, board.SPINDLE_PWM)
        forget("pio.beam_program")
    else:
        engine = PioEngine(*pins)
    port = GpioPort(board)
    engine.on_fault = port.kill
    forget("rp2")  # with our programs, which it has made, nearly 2 kB
    forget("pio.programs")
    return engine, port, stack.watch


def rmt(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """Pins of their own, by esp32.RMT."""
    from boot import parts_esp

    engine, port = parts_esp.rmt(board, link)
    forget("boot.parts_esp")
    return engine, port, None


def i2s(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """Shift registers, by machine.I2S."""
    from boot import parts_esp

    engine, port = parts_esp.i2s(board, link)
    forget("boot.parts_esp")
    return engine, port, None


def usb() -> "BoardLink":
    """The board's USB."""
    from ports.usb.usb_link import UsbLink

    link = UsbLink()
    forget("ports.usb.usb_ring")  # it has found what there is to find
    return link


def uart() -> "BoardLink":
    """UART 0 of an ESP32, or its native USB."""
    from ports.uart_link import UartLink

    return UartLink()


def wifi() -> "BoardLink":
    """The board's USB, and Wi-Fi: a Pico W."""
    import board
    from ports.net import wifi as air
    from ports.usb.usb_link import UsbLink

    option = board.__dict__.get
    link = air.beside(UsbLink(), option("PAGE", False))
    forget("ports.usb.usb_ring")
    forget("ports.net.wifi")
    return link


def uart_wifi() -> "BoardLink":
    """The same of an ESP32."""
    import board
    from ports.net import wifi as air
    from ports.uart_link import UartLink

    option = board.__dict__.get
    link = air.beside(UartLink(), option("PAGE", False))
    forget("ports.net.wifi")
    return link


# What a board file calls ENGINE: who makes it, with the pins that are not steps; what the board
# file has to name; which of these names are pins of the chip; how many steps a second one axis can
# expect where the board file does not say, for the tools; and per chip, as MicroPython calls it,
# the oldest MicroPython that will do, and what came with that.
_ENGINES: "dict[str, Engine]" = {
    "pio": (
        pio,
        ("STEP", "DIR"),
        ("STEP", "DIR", "ENABLE"),
        250_000,  # with pulses of 3 us
        (
            ("RP2040", (1, 26), "timers that interrupt at once"),
            ("RP2350", (1, 27), "DMA channels that can be given back"),
        ),
    ),
    "rmt": (
        rmt,
        ("STEP", "DIR"),
        ("STEP", "DIR", "ENABLE"),
        5_000,
        (("ESP32", (1, 27), "pulses of a resolution that is asked for"),),
    ),
    "i2s": (
        i2s,
        ("STEP", "DIR", "ENABLE", "I2S", "I2S_RATE_HZ", "I2S_BUFFERS"),
        ("I2S",),  # motors are behind shift registers, whose outputs have numbers of their own
        41_666,
        (("ESP32", (1, 27), "a firmware that was tried with none before"),),
    ),
}
# What a board file calls LINK: who makes it.
_LINKS: "dict[str, Callable[[], BoardLink]]" = {
    "usb": usb,
    "uart": uart,
    "wifi": wifi,
    "uart_wifi": uart_wifi,
}


# The machine


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

        option = board.__dict__.get
        link = _link(getattr(board, "LINK", "usb"))  # to tell by what is wrong
        from motion import layout

        # The biggest first, before there are holes.
        ring = layout.ring(len(option("STEP", ())), option("PLANNER_BLOCKS", 16))
        from ports.supervisor import Supervisor

        engine, port, watch_health = _hardware(board, link)
        if port.held(getattr(board, "REPL_PIN", None)):
            link.close()
            return None
        watch = Supervisor(link, engine, port, getattr(board, "LOOP_MS", _LOOP_MS))
        machine = _build(board, link, port, engine, watch, ring)
    except Exception as fault:
        if port:
            port.safe()
        stay(link, fault)
        return None
    finally:
        sys.path[:] = path
    if watch_health:
        machine.commands.health = watch_health()
    feed = port.watch(getattr(board, "WATCHDOG_MS", _WATCHDOG_MS))
    made: "list[object]" = [machine, link, port, engine, watch]
    for owner in (machine, machine.interpreter, machine.planner, engine, link):
        made.extend(owner.__dict__.values())
    del sys.modules["board"]

    def make_room() -> None:
        _forget_makers(made)

    watch.start(feed, machine.motor_control.note_reset)
    # Some word of machine code may look to the collector like the address of something in here:
    # that is not to lead to all of it. The last comes first.
    return machine, link, port, engine, watch, [globals().clear, make_room]


def _link(kind: str) -> "BoardLink":
    if kind not in _LINKS:
        raise ValueError("LINK %s is not one there is" % kind)
    return _LINKS[kind]()


def _hardware(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """What runs the machine; the engine's buffers are the first large things in memory."""
    from ports import pin_check

    from boot import select_extras

    _check_engine(board)
    _, _, pins, _, _ = _ENGINES[board.ENGINE]
    pin_check.check(board, pins, select_extras.pin_options(board))
    forget("ports.pin_check")
    return make(board, link)


def _check_engine(board: "ModuleType") -> None:
    """An engine there is, and all that it needs. Raises ValueError, which says what is missing."""
    engine: str = board.ENGINE
    if engine not in _ENGINES:
        raise ValueError("ENGINE %s is not one there is" % engine)
    _, needed, _, _, _ = _ENGINES[engine]
    missing = [name for name in needed if name not in board.__dict__]
    if missing:
        names = ", ".join(missing)
        raise ValueError("ENGINE = %s: the board file names no %s" % (engine, names))
    chip = getattr(sys.implementation, "_machine", "")
    why = too_old(engine, chip, sys.implementation.version[:2])
    if why:
        raise ValueError(why)


def too_old(engine: str, chip: str, version: "tuple[int, ...]") -> str:
    """Why this MicroPython is too old for that engine; "" where it is not. chip: as MicroPython
    names it, with the board perhaps."""
    _, _, _, _, rows = _ENGINES[engine]
    for name, oldest, why in rows:
        if name in chip and version < oldest:
            old = "MicroPython %d.%d is too old: " % version[:2]
            return old + "ENGINE %s on %s wants 1.%d or newer, for %s" % (
                engine,
                name,
                oldest[1],
                why,
            )
    return ""


def make(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """By a board file. Engine, pins and link work together. Raises MemoryError where compiled code
    finds no room on an ESP32."""
    maker, _, _, _, _ = _ENGINES[board.ENGINE]
    return maker(board, link)


def _build(
    board: "ModuleType",
    link: "BoardLink",
    port: "BoardPort",
    engine: "StepEngine",
    watch: "Supervisor",
    ring: "array[int]",
) -> "Controller":
    from ports.storage.flash_store import FlashStore

    from boot import wiring

    store = FlashStore()
    machine = wiring.build(board, link, port, engine, store, ring)
    forget("boot.wiring")  # with these, 5 kB that nobody needs any more
    forget("boot.options")
    forget("boot.select_extras")
    forget("ports.storage.user_files")
    for extra in _MAKING:
        forget(extra)
    if link.is_slow:
        machine.report.identity += _SLOW_RESET
    written = getattr(engine, "flash_written", None)
    store.before, store.after = machine.around_saves(watch.allow, written)
    link.attach(machine.at_rest, machine.welcome)
    return machine


# Memory


def forget(module: str) -> None:
    """Let go of a module, which its folder knows too."""
    there = sys.modules.pop(module, None)
    folder, _, name = module.rpartition(".")
    if there and folder:
        sys.modules[folder].__dict__.pop(name, None)


def _forget_makers(parts: "Iterable[object]") -> None:
    """Let go of what has made these: there is one of each, for good. Of their classes, of those
    that these are made of, and of their modules, each of which has many; and of extras."""
    left = [type(part) for part in parts]
    seen: "set[object]" = set()
    for name, module in sys.modules.items():
        if name.startswith("extras."):
            seen.add(module)
            _forget_in(module)
    while left:
        kind = left.pop()
        if "__module__" in kind.__dict__:
            left.extend(kind.__bases__)
            for thing in (kind, sys.modules[kind.__module__]):
                if thing not in seen:
                    seen.add(thing)
                    _forget_in(thing)


def _forget_in(thing: object) -> None:
    names, maker = thing.__dict__, MAKER  # a thousand names are looked at
    made = [name for name in MAKERS if name in names]
    for name in names:
        if maker in name:
            made.append(name)
    for name in made:
        setattr(thing, name, None)  # what is deleted stays in memory, in its place
