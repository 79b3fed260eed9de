"""Power up: choose the board's parts, build the machine, keep it running.

The last safety net is here too. Where a board file cannot be right, or something is missing,
nothing moves, and whoever asks is told why. Whatever goes wrong later that nobody has thought of
stops the motors, switches spindle and coolant off, and says so in one line; the machine is in
alarm then, until a soft reset.
"""

import gc
import io
import sys

import errors
import spindle as sp
import state as st
from micropython import const
from supervisor import Supervisor

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from controller import Controller
    from interfaces import StepEngine

    Parts = tuple[Controller, Any, Any, StepEngine, Supervisor]

_RESET = const(0x18)
_QUESTION = const(0x3F)
_LONGEST = const(120)

# Nothing of ours is there, and to look for each module of MicroPython's there takes 3 ms.
_USERS = "/lib"

# Stuck for so long, the chip starts anew: flash is written in less, the longest of all work.
_WATCHDOG_MS = const(5000)

# The main loop turns within so long, or the machine is stopped. A collection takes 30 ms at the
# most; who has more to do, in main.py say, reads the link in between.
_LOOP_MS = const(250)

# What $I says where Ctrl-X is not heard before the main loop reads; `ugrbl doctor` knows it.
_SLOW_RESET = " slow-reset"

# A save erases six sectors at the most, each in 400 ms.
_FLASH_MS = const(2500)


def build() -> "Parts | None":
    """Make the machine of board.py; None where there cannot be one, or the REPL is asked for."""
    link: "Any" = None
    port: "Any" = None
    watch: "Any" = None
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
        _stay(link, fault)
        return None
    finally:
        sys.path[:] = path
    if board.ENGINE == "pio":
        from pio import stack

        stack.paint()
        machine.commands.health = stack.report
    feed = port.watch(getattr(board, "WATCHDOG_MS", _WATCHDOG_MS))
    watch.start(feed, machine.realtime.reset)
    return machine, link, port, engine, watch


# Parts


def _link(kind: str) -> "Any":
    if kind == "uart":
        from link_uart import UartLink

        return UartLink()
    if kind == "usb":
        from link_usb import UsbLink

        return UsbLink()
    raise ValueError("LINK %s is not one there is" % kind)


def _hardware(board: "ModuleType", link: "Any") -> "tuple[StepEngine, Any]":
    """Engine and port; the engine's buffers are the first large things in memory."""
    import gpio_check

    gpio_check.check(board)
    del sys.modules["gpio_check"]
    import needs

    needs.check(board.ENGINE)
    del sys.modules["needs"]
    if board.ENGINE == "pio":
        from gpio import GpioPort
        from pio.engine import PioEngine

        hold_us = getattr(board, "DIR_HOLD_US", 2)
        setup_us = getattr(board, "DIR_SETUP_US", 5)
        engine = PioEngine(board.STEP, board.DIR, hold_us, setup_us)
        port = GpioPort(board)
        engine.on_fault = port.kill
        return engine, port
    from parts_esp import make

    return make(board, link)


def _build(
    board: "ModuleType", link: "Any", port: "Any", engine: "StepEngine", watch: Supervisor
) -> "Controller":
    from store_flash import FlashStore

    gc.collect()
    import wiring

    store = FlashStore()
    machine = wiring.build(board, link, port, engine, store)
    del sys.modules["wiring"]  # 4 kB that nobody needs any more
    if link.is_slow:
        machine.report.identity += _SLOW_RESET
    written = getattr(engine, "flash_written", None)
    store.before, store.after = _around_saves(machine, watch, written)

    def at_rest() -> bool:
        return machine.state.run in (st.IDLE, st.ALARM) and machine.planner.empty()

    def greet() -> None:
        if at_rest():
            machine.report.banner()

    link.attach(at_rest, greet)
    gc.collect()
    return machine


def _around_saves(
    machine: "Controller", watch: Supervisor, written: "Callable[[], None] | None"
) -> "tuple[Callable[[], None], Callable[[], None]]":
    """What to do before and after flash is written, which keeps all interrupts off.

    The machine is at rest then. A spindle goes on; a laser that M3 has switched on would burn for
    longer than the program says, and is off so long. written: the engine wants to hear of it.
    """

    lit = False
    state, spindle, gcode = machine.state, machine.spindle, machine.gcode

    def before() -> None:
        nonlocal lit
        watch.allow(_FLASH_MS)
        lit = spindle.laser and gcode.spindle == sp.CW and state.spindle_rpm > 0
        if lit:
            spindle.stop()

    def after() -> None:
        if written:
            written()
        watch.allow(0)
        if lit and not state.pending[st.RESET]:
            spindle.turn(sp.CW, gcode.spindle_rpm)

    return before, after


# Life


def live(parts: "Parts | None") -> "Controller | None":
    """Run the machine, for ever or until the REPL is asked for; returns it. main.py calls this
    and not build() does, for an interrupt needs what the stack has left."""
    if parts is None:
        return None
    machine, link, port, engine, watch = parts
    fault: "Exception | None" = None
    while True:
        try:
            if fault:
                _alarm(machine, link, fault)
            machine.power_up()
            machine.protocol.run()
        except KeyboardInterrupt:
            fault = None
        except Exception as unforeseen:
            fault = unforeseen
        port.safe()
        engine.stop()
        if fault is None:
            break
    port.watch(0)
    link.write(b"[MSG:Here is the REPL]\r\n")
    link.close()
    watch.close()
    return machine


def _alarm(machine: "Controller", link: "Any", fault: Exception) -> None:
    """Say what has happened, then wait for a soft reset."""
    machine.state.alarm = 0
    machine.state.run = st.ALARM
    link.write(b"ALARM:%d\r\n" % errors.ALARM_INTERNAL)
    link.write(_line(fault))
    buf = bytearray(16)
    while True:
        count = link.read_into(buf)
        for i in range(count):
            if buf[i] == _RESET:
                return
            if buf[i] == _QUESTION:
                link.write(machine.report.status())


def _stay(link: "Any", fault: Exception) -> None:
    """There is no machine: tell why, again to whoever writes to us."""
    line = _line(fault)
    if link is None:
        print(line.decode())
        return
    try:
        buf = bytearray(16)
        link.write(line)
        while True:
            if link.read_into(buf):
                link.write(line)
    except KeyboardInterrupt:
        return


def _line(fault: Exception) -> bytes:
    """A message of one line: what happened, and where."""
    text = io.StringIO()
    sys.print_exception(fault, text)
    lines = text.getvalue().strip().split("\n")
    place = lines[-2].strip() if len(lines) > 1 else ""
    return ("[MSG:%s]\r\n" % _harmless("%s %s" % (lines[-1], place))).encode()


def _harmless(text: str) -> str:
    """The text without what senders take for an answer ("ok", "error") or for a message's end."""
    clean = ""
    for c in text[:_LONGEST]:
        if clean[-1:] in ("o", "O") and c in ("k", "K"):
            clean += "-"
        clean += c if " " <= c <= "~" and c not in "[]" else " "
    for word in ("Error", "error", "ERROR"):
        clean = clean.replace(word, "Err")
    return clean
