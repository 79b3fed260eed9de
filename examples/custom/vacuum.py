"""Vacuum and air blast that follow spindle and laser.

OUTPUTS = {"vacuum": 20, "air": 21} in the board file. The vacuum runs for some seconds after M5.
The air blows while the spindle or the laser is on. A stop of the machine stops both at once.
"""

from ugrbl import every, on

RUN_ON_MS = 5000
SPIN_UP_S = 2.0  # a spindle needs time before it cuts; a laser does not

left_ms = 0  # that the vacuum still runs after M5


@on.spindle
def follow(m, word, rpm):
    global left_ms
    runs = word != "M5" and (rpm > 0 or m.is_laser)
    was_off = not m.is_on("air")
    m.out("air", runs)
    if runs:
        left_ms = 0
        m.out("vacuum", True)
        if was_off and not m.is_laser:
            m.wait(SPIN_UP_S)
    elif m.is_on("vacuum"):
        left_ms = RUN_ON_MS


@every(100)
def run_on(m):
    global left_ms
    if left_ms > 0:
        left_ms -= 100
        if left_ms <= 0:
            m.out("vacuum", False)
