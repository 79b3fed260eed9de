"""A parallel SCARA: two arms from shoulders side by side, whose forearms meet at the tool.

Joints: the X motor is the left arm, the Y motor the right one, in degrees from the X axis,
counterclockwise; Z is in mm. Elbows are outside, and the tool is in front of the shoulders. X0 Y0
is in the middle between the shoulders.
"""

import math

SHOULDER = 40.0  # mm from the middle to each shoulder
ARM = 80.0
FOREARM = 110.0
# How near the forearms may be to one straight line, mm across it. In line, the tool could go to
# either side.
CLEAR = 15.0

START = (120.0, 60.0, 0.0)  # where the joints are at power-up
HOME = (140.0, 40.0, 0.0)  # where each joint is when its switch closes
TRAVEL = (150.0, 150.0, 50.0)  # greatest distance of each to its switch
CENTRED = (0, 1)  # axes of space whose travel ($130, $131) goes to both sides of 0
FASTEST = 6000.0  # mm/min: no motion is faster, G0 included


def inverse(place, joints):
    """Fill in the joints for a place; False: out of reach. joints holds the last values."""
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
    """Fill in the place for the joints."""
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
