"""Parts: selects the board's hardware, builds the machine, and frees the code that did it.

The tables _ENGINES and _LINKS describe every engine and link; the tools read them too. A board
forgets this module once the machine is built.
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

    # Work that can wait until the first welcome: each is called once, and dropped.
    Later = list[Callable[[], None]]
    Parts = tuple[Controller, BoardLink, BoardPort, StepEngine, Supervisor, Later]
    # Engine, pins, and a function that starts to watch the chip's health, for $I+.
    Hardware = tuple[StepEngine, BoardPort, Callable[[], Callable[[], str]] | None]
    Oldest = tuple[str, tuple[int, int], str]
    Engine = tuple[
        Callable[[ModuleType, BoardLink], Hardware],
        tuple[str, ...],
        tuple[str, ...],
        int,
        tuple[Oldest, ...],
    ]

# Longest time without a feed before the chip resets. Writing flash, the longest work, takes less.
_WATCHDOG_MS = const(5000)  # for a board file without WATCHDOG_MS

# Longest turn of the main loop; after that the machine is stopped. A garbage collection takes
# 30 ms at most. Code with more to do, in main.py for example, must read the link in between.
_LOOP_MS = const(250)  # longest turn of the main loop, for a board file without LOOP_MS

# Added to $I where Ctrl-X takes effect only when the main loop reads; `ugrbl doctor` knows it.
_SLOW_RESET = " slow-reset"  # added to $I

# Modules that are needed only while the machine is built, some 7 kB together.
_BUILDING = (
    "boot.wiring",
    "boot.options",
    "boot.select_extras",
    "ports.storage.user_files",
    "extras.kinematics.nonlinear",
    "extras.kinematics.motor_matrix",
)

# Names of functions that are needed only while the machine is built: in a class or module those
# with MAKER in their name, too; the last two are those of extras.
MAKERS = ("__init__", "connect", "prepare", "install")  # whole names
MAKER = "_make_"  # part of the name of such a function


# Engines and links. A build keeps only the imports of those that the board file names.


def pio(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """Create an engine on the state machines of a PIO. Returns it, the port, and the function that
    starts to watch the stack, for $I+."""
    from pio import stack
    from pio.engine import PioEngine
    from pio.pins import GpioPort

    option = board.__dict__.get  # getattr() would intern the names for good
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
    forget("rp2")  # nearly 2 kB, with the assembler of our programs
    forget("pio.programs")
    return engine, port, stack.watch


def rmt(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """Create an engine on pins of its own, with esp32.RMT. Returns it, the port, and None: nothing
    watches the chip's health."""
    from boot import parts_esp

    engine, port = parts_esp.rmt(board, link)
    forget("boot.parts_esp")
    return engine, port, None


def i2s(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """Create an engine on shift registers, with machine.I2S. Returns it, the port, and None:
    nothing watches the chip's health."""
    from boot import parts_esp

    engine, port = parts_esp.i2s(board, link)
    forget("boot.parts_esp")
    return engine, port, None


def usb() -> "BoardLink":
    """Create the link over the board's USB."""
    from ports.usb.usb_link import UsbLink

    link = UsbLink()
    forget("ports.usb.usb_ring")  # it has found the ring, and is not needed again
    return link


def uart() -> "BoardLink":
    """Create the link over UART 0 of an ESP32, or its native USB."""
    from ports.uart_link import UartLink

    return UartLink()


def wifi() -> "BoardLink":
    """Create the link of a Pico W: its USB, and Wi-Fi, with PAGE also for the page."""
    import board
    from ports.net import wifi as air
    from ports.usb.usb_link import UsbLink

    option = board.__dict__.get
    link = air.beside(UsbLink(), option("PAGE", False))
    forget("ports.usb.usb_ring")
    forget("ports.net.wifi")
    return link


def uart_wifi() -> "BoardLink":
    """Create the link of an ESP32: its UART, and Wi-Fi, with PAGE also for the page."""
    import board
    from ports.net import wifi as air
    from ports.uart_link import UartLink

    option = board.__dict__.get
    link = air.beside(UartLink(), option("PAGE", False))
    forget("ports.net.wifi")
    return link


# ENGINE of a board file: its constructor, which also makes the port; the names that the board file
# must have; which of them are pins of the chip; the steps per second of one axis that the tools
# assume if the board file does not say; and per chip, as MicroPython names it, the oldest
# MicroPython that works, and the reason.
_ENGINES: "dict[str, Engine]" = {
    "pio": (
        pio,
        ("STEP", "DIR"),
        ("STEP", "DIR", "ENABLE"),
        250_000,  # with pulses of 3 us
        (
            ("RP2040", (1, 26), "hard timer interrupts"),
            ("RP2350", (1, 27), "DMA channels that can be released"),
        ),
    ),
    "rmt": (
        rmt,
        ("STEP", "DIR"),
        ("STEP", "DIR", "ENABLE"),
        5_000,
        (("ESP32", (1, 27), "RMT pulses of a chosen resolution"),),
    ),
    "i2s": (
        i2s,
        ("STEP", "DIR", "ENABLE", "I2S", "I2S_RATE_HZ", "I2S_BUFFERS"),
        ("I2S",),  # shift registers drive the motors; their outputs have numbers of their own
        41_666,
        (("ESP32", (1, 27), "I2S output as tested"),),
    ),
}
# LINK of a board file: its constructor.
_LINKS: "dict[str, Callable[[], BoardLink]]" = {
    "usb": usb,
    "uart": uart,
    "wifi": wifi,
    "uart_wifi": uart_wifi,
}


# The machine


def build(stay: "Callable[[BoardLink | None, Exception], None]") -> "Parts | None":
    """Build the machine of board.py. Returns it, its link, port, engine and supervisor, and the
    work that can wait (Later); None if that is impossible, or the REPL is requested.

    stay: called with the link, or None, and the exception that made it impossible; it returns when
    the REPL is requested.
    """
    link: "BoardLink | None" = None
    port: "BoardPort | None" = None
    try:
        import board

        option = board.__dict__.get
        link = _link(getattr(board, "LINK", "usb"))  # first, so that errors can be reported
        from motion import layout

        # The largest allocation first, while memory is not fragmented.
        ring = layout.ring(len(option("STEP", ())), option("PLANNER_BLOCKS", 16))
        from ports.supervisor import Supervisor

        engine, port, watch_health = _hardware(board, link)
        if port.held(getattr(board, "REPL_PIN", None)):  # a button requests the REPL
            link.close()
            return None
        watch = Supervisor(link, engine, port, getattr(board, "LOOP_MS", _LOOP_MS))
        machine = _build(board, link, port, engine, watch, ring)
    except Exception as fault:
        if port:
            port.safe()
        stay(link, fault)
        return None
    feed_watchdog = port.watch(getattr(board, "WATCHDOG_MS", _WATCHDOG_MS))
    # All long-lived objects: these, and those that they refer to.
    long_lived: "list[object]" = [machine, link, port, engine, watch]
    for owner in (machine, machine.interpreter, machine.planner, engine, link):
        long_lived.extend(owner.__dict__.values())
    del sys.modules["board"]  # its options were used: free them

    def start() -> None:
        """Start to watch the chip's health for $I+. That fills the unused stack with a pattern:
        build() has returned, and what it has left there is no longer needed."""
        if watch_health:
            machine.commands.health = watch_health()

    def make_room() -> None:
        """Free the functions that built the machine, once it has started."""
        _forget_makers(long_lived)

    # From here on a timer's interrupt feeds the watchdog, and stops a machine whose loop hangs.
    watch.start(feed_watchdog, machine.motor_control.note_reset)

    # power_up.py removes and calls these from the end: start() before the machine runs; after its
    # first welcome make_room(), and then the one that frees this module.
    later: "Later" = [lambda: forget("boot.parts"), make_room, start]
    return machine, link, port, engine, watch, later


def _link(kind: str) -> "BoardLink":
    """Create the link of a name in _LINKS (kind), the board file's LINK. Raises ValueError for
    another name."""
    from boot import select_extras

    link: "BoardLink" = select_extras.known("LINK", kind, _LINKS)()
    return link


def _hardware(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """Check the board file's engine and pins, and create engine and port. ValueError if the board
    file is wrong. Called early, because the engine's buffers need large blocks of memory."""
    from ports import pin_check

    from boot import select_extras

    _check_engine(board)
    _, _, pins, _, _ = _ENGINES[board.ENGINE]  # the board file's names for the engine's pins
    pin_check.check(board, pins, select_extras.pin_options(board))
    forget("ports.pin_check")
    return make(board, link)


def _check_engine(board: "ModuleType") -> None:
    """Check that the engine exists and has all that it needs. Raises ValueError with the cause."""
    from boot import select_extras

    engine: str = board.ENGINE
    _, needed, _, _, _ = select_extras.known("ENGINE", engine, _ENGINES)
    missing = [name for name in needed if name not in board.__dict__]
    if missing:
        names = ", ".join(missing)
        raise ValueError("ENGINE = %s requires %s in the board file" % (engine, names))
    chip = getattr(sys.implementation, "_machine", "")
    why = too_old(engine, chip, sys.implementation.version[:2])
    if why:
        raise ValueError(why)


def too_old(engine: str, chip: str, version: "tuple[int, ...]") -> str:
    """Return why this MicroPython is too old for that engine, or "" if it is not.

    chip: MicroPython's name for it, perhaps with that of the board; version: (major, minor).
    """
    _, _, _, _, rows = _ENGINES[engine]
    for name, oldest, why in rows:
        if name in chip and version < oldest:
            old = "MicroPython %d.%d is too old: " % version[:2]
            return old + "ENGINE %s on %s needs 1.%d or newer, for %s" % (
                engine,
                name,
                oldest[1],
                why,
            )
    return ""


def make(board: "ModuleType", link: "BoardLink") -> "Hardware":
    """Create the board file's engine and port, and connect them to the link. Raises MemoryError if
    an ESP32 has no memory for compiled code."""
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
    """Build the machine on its hardware, and free the modules that did it. ring: the planner's."""
    from ports.storage.flash_store import FlashStore

    from boot import wiring

    store = FlashStore()
    machine = wiring.build(board, link, port, engine, store, ring)
    for name in _BUILDING:
        forget(name)
    if link.is_slow:  # Ctrl-X waits for the main loop
        machine.report.identity += _SLOW_RESET
    # A write to flash stops all interrupts: the supervisor then allows the loop a longer turn,
    # and some engines must be notified after it.
    notify_engine = getattr(engine, "flash_written", None)
    store.before, store.after = machine.around_saves(watch.allow, notify_engine)
    link.attach(machine.at_rest, machine.welcome)  # may the REPL be requested; greet a sender
    return machine


# Memory


def forget(module: str) -> None:
    """Remove a module that nothing uses any more from sys.modules and its package, and empty it.

    It is emptied because to the garbage collector a word of machine code may look like the address
    of the module, which then stays in memory with all that it refers to.
    """
    removed = sys.modules.pop(module, None)
    folder, _, name = module.rpartition(".")
    if removed and folder:
        sys.modules[folder].__dict__.pop(name, None)
    if removed:
        removed.__dict__.clear()


def _forget_makers(parts: "Iterable[object]") -> None:
    """Free the functions that built these objects, because none is built twice: _forget_in() is
    called for the objects' classes, the base classes, the modules of all these, and the extras; in
    the API of extras it also frees the methods that are called at installation only."""
    classes = [type(part) for part in parts]
    done: "set[object]" = set()  # classes and modules
    for name, module in sys.modules.items():
        if name.startswith("extras."):
            done.add(module)
            _forget_in(module)
    api = sys.modules.get("extras.api")
    if api:
        _forget_in(api.Cnc, api.MAKERS)  # 2 kB
    while classes:
        kind = classes.pop()
        if "__module__" in kind.__dict__:  # a class of ours: built-in ones have none
            classes.extend(kind.__bases__)
            for owner in (kind, sys.modules[kind.__module__]):
                if owner not in done:
                    done.add(owner)
                    _forget_in(owner)


def _forget_in(owner: object, words: "tuple[str, ...]" = (MAKER,)) -> None:
    """Free the functions of a class or module (owner) that are needed only while the machine is
    built: those with a name of MAKERS, and those with one of these words in their names."""
    names = owner.__dict__  # a local, because a thousand names are checked
    makers = [name for name in MAKERS if name in names]
    for word in words:
        makers += [name for name in names if word in name]
    for name in makers:
        setattr(owner, name, None)  # deleting frees no more: the table keeps the slot
