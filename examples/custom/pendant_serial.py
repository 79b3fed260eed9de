"""A pendant on a serial line: a wheel, an axis switch, a speed knob, and an enabling button.

UART 1 on GP8 and GP9, 115200. The pendant's own board sends a frame 50 times a second: 0xA5, axis
(0 is X), clicks of the wheel since the last frame (signed), hundredths of a mm for each, speed in
percent, buttons (1 enabling, 2 plus, 4 minus, 8 hold), and the sum of all these modulo 256. A
wrong frame is left out. If none comes for a quarter of a second, or the enabling button is
released, a jog ends. It jogs in Idle only; hold acts always.
"""

from machine import UART, Pin
from ugrbl import every

FRAME, START, AXES = 7, 0xA5, "XYZABC"
ENABLE, PLUS, MINUS, HOLD = 1, 2, 4, 8
RATE = 3000  # mm/min at 100 %
TURN_MS, SILENCE = 20, 12  # turns without a frame

bus = UART(1, baudrate=115200, tx=Pin(8), rx=Pin(9))
heard = bytearray()
seen = {"silent": 0, "jogs": False, "held": False}


def frames():
    heard.extend(bus.read() or b"")
    while len(heard) >= FRAME:
        frame = bytes(heard[:FRAME])
        is_whole = frame[0] == START and sum(frame[:-1]) & 255 == frame[-1]
        heard[:] = heard[FRAME if is_whole else 1 :]
        if is_whole:
            yield frame


def obey(m, axis, clicks, hundredths, percent, buttons):
    if buttons & HOLD and not seen["held"]:
        m.hold()
    seen["held"] = bool(buttons & HOLD)
    rate = max(RATE * min(percent, 100) / 100, 1)
    way = (buttons & PLUS > 0) - (buttons & MINUS > 0)
    if not buttons & ENABLE or axis >= len(AXES) or (seen["jogs"] and not way):
        stop(m)
    elif way:
        seen["jogs"] = m.jog(AXES[axis], way * rate / 60 * TURN_MS / 1000, rate) or seen["jogs"]
    elif clicks:
        m.jog(AXES[axis], (clicks - 256 if clicks > 127 else clicks) * hundredths / 100, rate)


def stop(m):
    seen["jogs"] = False
    m.end_jog()


@every(TURN_MS)
def listen(m):
    seen["silent"] += 1
    for frame in frames():
        seen["silent"] = 0
        obey(m, *frame[1:-1])
    if seen["silent"] == SILENCE:
        stop(m)
