"""Power up: have the machine built (parts.py), keep it running.

The last safety net is here too. Where a board file cannot be right, or something is missing,
nothing moves, and whoever asks is told why. Whatever goes wrong later that nobody has thought of
stops the motors, switches spindle and coolant off, and says so in one line; the machine is in
alarm then, until a soft reset.
"""

import gc
import time

from base import errors
from base import state as st
from base.faults import sanitize, trace
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import BoardLink
    from talk.controller import Controller

    from boot.parts import Parts

_RESET = const(0x18)
_QUESTION = const(0x3F)
_DOLLAR = const(0x24)
_MESSAGE = "[MSG:%s]"
# Garbage is collected after so many bytes while modules are imported. What an import leaves for
# good lies between what it needs for a moment: without this the largest hole was 2.7 kB in 95 kB
# that were free, with it 35 kB.
_COLLECT_BYTES = const(32768)


def build() -> "Parts | None":
    """Make the machine of board.py; None where there cannot be one, or the REPL is asked for."""
    gc.threshold(_COLLECT_BYTES)
    try:
        from boot import parts  # and with it all else
    except Exception as fault:
        _stay_without_parts(fault)
        return None
    made = parts.build(_stay)
    parts.forget("boot.parts")
    gc.threshold(-1)
    return made


def run_machine(parts: "Parts | None") -> "Controller | None":
    """Run the machine, for ever or until the REPL is asked for; returns it. main.py calls this
    and not build() does, for an interrupt needs what the stack has left."""
    if parts is None:
        return None
    machine, link, port, engine, watch, later = parts

    # Whoever calls a kernel stays in its memory until the next one does: not parts.py, which goes.
    def begin() -> None:
        machine.restart()
        while later:
            later.pop()()
        gc.collect()
        machine.protocol.restart = machine.restart

    machine.protocol.restart = begin
    fault: "BaseException | None" = None
    while True:
        try:
            if fault:
                _alarm(machine, link, fault)
            machine.power_up()
            machine.protocol.run()
        except KeyboardInterrupt as stop:
            # Ctrl-X, if it has ended what would not come back; else the prompt is asked for.
            fault = stop if watch.end_absence() else None
        except (Exception, SystemExit) as unforeseen:  # sys.exit() would leave motors running
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


def _alarm(machine: "Controller", link: "BoardLink", fault: BaseException) -> None:
    """Say what has happened, again to who begins a $-command; then wait for a soft reset."""
    machine.state.alarm = 0
    machine.state.enter(st.ALARM)
    link.write(b"ALARM:%d\r\n" % errors.ALARM_INTERNAL)
    machine.commands.fault = text = _text(fault)
    line = _line(text)
    link.write(line)
    buf = bytearray(16)
    while True:
        count = link.read_into(buf)
        for i in range(count):
            if buf[i] == _RESET:
                return
            if buf[i] == _QUESTION:
                link.write(machine.report.status())
            elif buf[i] == _DOLLAR:
                link.write(line)


def _stay(link: "BoardLink | None", fault: Exception) -> None:
    """There is no machine: tell why, again to whoever writes to us."""
    text = _text(fault)
    if link is None:
        print(_MESSAGE % text)
        return
    line = _line(text)
    try:
        buf = bytearray(16)
        link.write(line)
        while True:
            if link.read_into(buf):
                link.write(line)
    except KeyboardInterrupt:
        return


def _stay_without_parts(fault: Exception) -> None:
    """The same where a file is missing or spoilt: nothing is there that hears who writes, so it is
    told every second. What is typed is left to the prompt."""
    text = _MESSAGE % _text(fault)
    try:
        while True:
            print(text)
            time.sleep(1)
    except KeyboardInterrupt:
        return


def _line(text: str) -> bytes:
    return (_MESSAGE % text + "\r\n").encode()


def _text(fault: BaseException) -> str:
    """What happened, where, and in which build."""
    lines = trace(fault)
    place = lines[-2].strip() if len(lines) > 1 else ""
    return "%s (%s)" % (sanitize("%s %s" % (lines[-1], place)), errors.BUILD_ID)
