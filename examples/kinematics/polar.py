"""A polar plotter: the table turns, and an arm moves the pen from its middle outwards.

Joints: the X motor is the pen's distance from the middle, in mm; the Y motor is the table, in
degrees; Z is in mm. The tool's place is relative to the table.
"""

import math

REACH = 150.0  # mm

START = (0.0, 0.0, 0.0)  # where the joints are at power-up
HOME = (REACH, 0.0, 0.0)  # where each joint is when its switch closes
TRAVEL = (REACH, 360.0, 50.0)  # greatest distance of each to its switch
CENTRED = (0, 1)  # axes of space whose travel ($130, $131) goes to both sides of 0
FASTEST = 6000.0  # mm/min: no motion is faster, G0 included


def inverse(place, joints):
    """Fill in the joints for a place; False: out of reach. joints holds the last values."""
    x, y = place[0], place[1]
    radius = math.sqrt(x * x + y * y)
    if radius > REACH:
        return False
    if radius > 0:  # in the middle the table keeps its angle
        turned = math.degrees(math.atan2(y, x)) - joints[1]
        joints[1] += turned - 360 * math.floor(turned / 360 + 0.5)  # the shorter way round
    joints[0] = radius
    joints[2] = place[2]
    return True


def forward(joints, place):
    """Fill in the place for the joints."""
    angle = math.radians(joints[1])
    place[0] = joints[0] * math.cos(angle)
    place[1] = joints[0] * math.sin(angle)
    place[2] = joints[2]
