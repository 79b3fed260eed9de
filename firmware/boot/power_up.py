"""Power up: builds the machine (parts.py) and keeps it running.

This is also the last safety net. If the board file is wrong or a file is missing, nothing moves,
and the cause is reported to every client that writes. An unforeseen exception later stops the
motors, switches spindle and coolant off, and is reported in one line; the machine is then in alarm
until a soft reset.
"""

import gc
import sys
import time

from base import errors
from base import state as st
from base.text import sanitize, trace
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from interfaces import BoardLink
    from talk.controller import Controller

    from boot.parts import Parts

_RESET = const(0x18)  # bytes: Ctrl-X, ?, $
_QUESTION = const(0x3F)
_DOLLAR = const(0x24)
_MESSAGE = "[MSG:%s]"
# While modules are imported, garbage is collected each time so many bytes were allocated. What an
# import leaves for good would otherwise lie between its temporary objects: the largest free block
# was 2.7 kB of 95 kB free without this, and is 35 to 50 kB with it.
_COLLECT_BYTES = const(65536)  # garbage is collected after so many
# Modules of MicroPython that many of ours import. MicroPython does not enter them in sys.modules,
# and looks among the files first, for 1 ms at each import.
_BUILT_IN = ("array", "io", "machine", "os", "time")  # modules of MicroPython


def build() -> "Parts | None":
    """Build the machine of board.py; None if that is impossible, or the REPL is requested."""
    gc.threshold(_COLLECT_BYTES)  # collect after so many bytes, while modules are imported
    for name in _BUILT_IN:  # else each import of these searches the files first
        sys.modules[name] = __import__(name)
    try:
        from boot import parts  # imports everything else
    except Exception as fault:
        _stay_without_parts(fault)
        return None
    machine_parts = parts.build(_stay)
    gc.threshold(-1)  # collect only when memory is used up
    return machine_parts


def run_machine(parts: "Parts | None") -> "Controller | None":
    """Run the machine, for ever or until the REPL is requested; return it, or None without parts.
    main.py calls this after build() has returned: an interrupt needs that part of the stack."""
    if parts is None:
        return None
    machine, link, port, engine, watch, later = parts
    if later:  # empty if this is called again, after the REPL
        later.pop()()  # parts.build()'s start(), at this depth of the stack

    # A kernel's memory keeps a reference to its last caller until it is called again. So begin()
    # is here, and not in parts.py, which must be freed.
    def begin() -> None:
        """Restart the machine for the first time, then do the work that could wait. At later
        resets the protocol calls machine.restart itself."""
        machine.restart()
        while later:
            later.pop()()
        for name in _BUILT_IN:  # they were entered for the imports only
            del sys.modules[name]
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
            # The watchdog's Ctrl-X ended code that did not return; else the REPL is requested.
            fault = stop if watch.end_absence() else None  # None ends the loop
        except (Exception, SystemExit) as unforeseen:  # sys.exit() would leave motors running
            fault = unforeseen
        port.safe()
        engine.stop()
        if fault is None:
            break
    port.watch(0)  # stop the watchdog
    link.write(b"[MSG:Here is the REPL]\r\n")
    link.close()
    watch.close()
    return machine


def _alarm(machine: "Controller", link: "BoardLink", fault: BaseException) -> None:
    """Enter Alarm and report the fault, again at each `$`; answer `?`; return at a soft reset.
    Nothing else is executed meanwhile."""
    machine.state.alarm = 0  # none that the loop would report later
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
    """Report why there is no machine, again whenever bytes arrive, until Ctrl-C ends this. link:
    None if not even that could be made: the cause is then printed once."""
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
    """Report the cause if a file is missing or damaged. Without a link no bytes can be read, so it
    is printed every second. Typed characters are left to the prompt."""
    text = _MESSAGE % _text(fault)
    try:
        while True:
            print(text)
            time.sleep(1)
    except KeyboardInterrupt:
        return


def _line(text: str) -> bytes:
    """Return the text as a message to the sender, in bytes."""
    return (_MESSAGE % text + "\r\n").encode()


def _text(fault: BaseException) -> str:
    """Return as text the exception, its place in the source, and the firmware's build."""
    lines = trace(fault)  # the exception is in the last line, its place in the one before
    place = lines[-2].strip() if len(lines) > 1 else ""
    return "%s (%s)" % (sanitize("%s %s" % (lines[-1], place)), errors.BUILD_ID)
