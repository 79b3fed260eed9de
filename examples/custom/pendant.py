"""A pendant: a wheel with two contacts, a switch for the axis, and two buttons that jog.

INPUTS = {"wheel_a": 10, "wheel_b": 11, "z": 12, "y": 13, "plus": 14, "minus": 15, "coarse": 16} in
the board file; X is jogged if neither y nor z is closed. A button jogs as long as it is held.
The pendant works only in Idle, so that an accidental touch cannot disturb a program.
"""

from ugrbl import every, on

FINE, COARSE = 0.01, 0.1  # mm per edge of the wheel
RATE = 1200  # mm/min
TURN_MS = 20

edges = 0
held = False


@on.input("wheel_a")
def wheel(m, closed):
    global edges
    edges += 1 if closed != m.pin("wheel_b") else -1


@every(TURN_MS)
def jog(m):
    global edges, held
    axis = "Z" if m.pin("z") else "Y" if m.pin("y") else "X"
    way = m.pin("plus") - m.pin("minus")
    if way:
        held = m.jog(axis, way * RATE / 60 * TURN_MS / 1000, RATE) or held
    elif held:
        held = False
        m.end_jog()
    elif edges:
        m.jog(axis, edges * (COARSE if m.pin("coarse") else FINE), RATE)
    edges = 0


@on.alarm
def forget(m, number):
    global held
    held = False
