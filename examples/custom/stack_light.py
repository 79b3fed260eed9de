"""A stack light and a buzzer: green means running, yellow waiting for an operator, red alarm.

OUTPUTS = {"green": 18, "yellow": 19, "well": 20, "buzzer": 21} in the board file. Wire red to the
normally closed contact of the relay "well". So everything that switches outputs off also lights
red: a reset, a limit switch, a controller without power. No program is needed for this.
"""

from ugrbl import every, on

WAITING = ("Hold", "Door", "Sleep")
WORKING = ("Run", "Jog", "Home")

beats = 0


def show(m):
    m.out("well", m.state != "Alarm")
    m.out("green", m.state in WORKING)
    m.out("yellow", m.state in WAITING)


@on.state_change
def changed(m, was, now):
    global beats
    beats = 0
    show(m)


@on.startup
@on.after_reset
def begin(m):
    show(m)


@every(250)
def beat(m):
    """Beep twice when an operator is needed, and again every ten seconds."""
    global beats
    wanted = m.state in WAITING or m.state == "Alarm"
    m.out("buzzer", wanted and beats % 40 in (0, 2))
    beats += 1
