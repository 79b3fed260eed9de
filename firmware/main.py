"""Power up: choose the board's parts, build the machine, keep it running.

The last safety net is here too: whatever goes wrong that nobody has thought of stops the motors,
switches spindle and coolant off, and says so in one line; the machine is in alarm then, until a
soft reset. A board file that cannot be right is said so, and nothing moves.
"""

import gc
import io
import sys

import errors
import state as st
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from controller import Controller
    from interfaces import Link, StepEngine

_RESET = const(0x18)
_QUESTION = const(0x3F)
_LONGEST = const(120)

# Names in a board file that stand for pins, or for tuples of them.
_PINS = (
    "STEP DIR ENABLE LIMIT PROBE CONTROL REPL_PIN SPINDLE_PWM SPINDLE_DIR SPINDLE_ON FLOOD "
    "MIST_PIN PUNCH_DOWN PUNCH_UP PUNCH_DOWN_SENSOR PUNCH_UP_SENSOR"
)


def main() -> None:
    """Run the machine of board.py, for ever or until the REPL is asked for."""
    try:
        import board
    except ImportError:
        print("[MSG:There is no board.py: copy one of boards/ there]")
        return
    link = _link(getattr(board, "LINK", "usb"))
    try:
        wrong = _twice(board)
        if wrong:
            raise ValueError(wrong)
        engine, port = _hardware(board)
    except (ValueError, AttributeError, ImportError, OSError) as fault:
        _tell(link, "board.py: ", fault)
        return
    if port.held(getattr(board, "REPL_PIN", None)):
        return
    _run(board, link, port, engine)


def _link(kind: str) -> "Any":
    if kind == "uart":
        from link_uart import UartLink

        return UartLink()
    from link_usb import UsbLink

    return UsbLink()


def _hardware(board: "ModuleType") -> "tuple[Any, Any]":
    """Engine and port; the engine's buffers are the first large things in memory."""
    kind = board.ENGINE
    if kind == "pio":
        from gpio import GpioPort
        from pio.engine import PioEngine

        hold_us = getattr(board, "DIR_HOLD_US", 2)
        setup_us = getattr(board, "DIR_SETUP_US", 5)
        return PioEngine(board.STEP, board.DIR, hold_us, setup_us), GpioPort(board)
    from gpio_esp import EspPort

    if kind == "rmt":
        from esp.rmt import RmtEngine

        return RmtEngine(board.STEP, board.DIR), EspPort(board)
    if kind == "i2s":
        from esp.i2s import I2sEngine

        engine = I2sEngine(
            board.STEP, board.DIR, board.ENABLE, board.I2S, board.I2S_RATE_HZ, board.I2S_BUFFERS
        )
        return engine, EspPort(board, engine.enable)
    raise ValueError("ENGINE %s is not one there is" % kind)


def _twice(board: "ModuleType") -> str:
    """What pin has two names, in words; none on a shift register."""
    if board.ENGINE == "i2s":
        return ""
    used: "dict[int, str]" = {}
    for name in _PINS.split():
        value = getattr(board, name, None)
        for pin in value if isinstance(value, tuple) else (value,):
            if pin is None:
                continue
            if pin in used:
                return "pin %d is %s and %s" % (pin, used[pin], name)
            used[pin] = name
    return ""


def _run(board: "ModuleType", link: "Any", port: "Any", engine: "StepEngine") -> None:
    from store_flash import FlashStore

    gc.collect()
    import controller

    machine = controller.build(board, link, port, engine, FlashStore())
    link.at_rest = lambda: machine.state.run in (st.IDLE, st.ALARM)
    timeout_ms = getattr(board, "WATCHDOG_MS", 0)
    if timeout_ms:
        link.watchdog = port.watchdog(timeout_ms)
    gc.collect()
    try:
        while True:
            try:
                machine.run()
            except Exception as fault:
                _stand_still(link, port, engine)
                machine.state.alarm = 0
                machine.state.run = st.ALARM
                link.write(b"ALARM:%d\r\n" % errors.ALARM_INTERNAL)
                _tell(link, "Fault: ", fault)
                _wait_for_reset(link, machine)
    except KeyboardInterrupt:
        _stand_still(link, port, engine)
        if timeout_ms:
            port.pacify(link.watchdog)
        link.write(b"[MSG:Here is the REPL]\r\n")


def _stand_still(link: "Link", port: "Any", engine: "StepEngine") -> None:
    engine.stop()
    port.safe()


def _wait_for_reset(link: "Link", machine: "Controller") -> None:
    buf = bytearray(16)
    while True:
        count = link.read_into(buf)
        for i in range(count):
            if buf[i] == _RESET:
                return
            if buf[i] == _QUESTION:
                machine.report.status()


def _tell(link: "Link", what: str, fault: Exception) -> None:
    """One line of an exception, with where it came from."""
    text = io.StringIO()
    sys.print_exception(fault, text)
    lines = text.getvalue().strip().split("\n")
    place = lines[-2].strip() if len(lines) > 1 else ""
    link.write(("[MSG:%s]\r\n" % _harmless("%s%s %s" % (what, lines[-1], place))).encode())


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


if __name__ == "__main__":
    main()
