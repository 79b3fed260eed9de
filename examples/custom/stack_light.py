"""A stack light and a buzzer: green runs, yellow waits for somebody, red is alarm.

OUTPUTS = {"green": 18, "yellow": 19, "well": 20, "buzzer": 21} in the board file. Red hangs on the
closed contact of the relay "well": it is lit by whatever takes outputs away, a reset, a limit
switch, a controller without power, and needs no program for it.
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
    """Two beeps when somebody is wanted, and again every ten seconds."""
    global beats
    wanted = m.state in WAITING or m.state == "Alarm"
    m.out("buzzer", wanted and beats % 40 in (0, 2))
    beats += 1
