"""A parallel SCARA: two arms from shoulders side by side, whose forearms meet at the tool.

Joints: X motor, the left arm, Y motor, the right one, in degrees from the X axis, against the
clock; Z in mm. Elbows are outside, and the tool in front of the shoulders. X0 Y0 is in the middle
between them.
"""

import math

SHOULDER = 40.0  # mm: from the middle to each
ARM = 80.0
FOREARM = 110.0
# How near forearms may come to lie in one line, mm across it: there the tool may go either way.
CLEAR = 15.0

START = (120.0, 60.0, 0.0)  # where the joints are at power-up
HOME = (140.0, 40.0, 0.0)  # and where each is when its switch closes
TRAVEL = (150.0, 150.0, 50.0)  # how far it is to a switch at the most
CENTRED = (0, 1)  # axes of space whose travel ($130, $131) goes to either side of 0
FASTEST = 6000.0  # mm/min: no motion is faster, G0 included


def inverse(place, joints):
    """Fill in the joints for a place. They hold where they are before. False: out of reach."""
    x, y = place[0], place[1]
    if y <= 0:
        return False
    for i in (0, 1):
        side = -1 if i == 0 else 1
        across = x - side * SHOULDER
        squares = across * across + y * y
        cosine = (ARM * ARM + squares - FOREARM * FOREARM) / (2 * ARM * math.sqrt(squares))
        if not -1 < cosine < 1:
            return False
        angle = math.degrees(math.atan2(y, across) - side * math.acos(cosine))
        joints[i] += (angle - joints[i] + 180) % 360 - 180  # the shorter way round
    joints[2] = place[2]
    left, a, right, b = _elbows(joints)
    ahead = (right - left) * (y - a) - (b - a) * (x - left)
    return ahead > CLEAR * _apart(left, a, right, b)


def forward(joints, place):
    """Fill in the place for these joints."""
    left, a, right, b = _elbows(joints)
    apart = _apart(left, a, right, b)
    squares = FOREARM * FOREARM - apart * apart / 4
    ahead = math.sqrt(squares) / apart if squares > 0 else 0.0
    place[0] = (left + right) / 2 - ahead * (b - a)
    place[1] = (a + b) / 2 + ahead * (right - left)
    place[2] = joints[2]


def _elbows(joints):
    left, right = math.radians(joints[0]), math.radians(joints[1])
    return (
        -SHOULDER + ARM * math.cos(left),
        ARM * math.sin(left),
        SHOULDER + ARM * math.cos(right),
        ARM * math.sin(right),
    )


def _apart(left, a, right, b):
    return math.sqrt((right - left) ** 2 + (b - a) ** 2) or 1.0
