"""A polar plotter: the table turns, and an arm moves the pen from its middle outwards.

Joints: X motor, how far the pen is from the middle, in mm; Y motor, the table, in degrees; Z in
mm. The place of the tool is seen from the table.
"""

import math

REACH = 150.0  # mm

START = (0.0, 0.0, 0.0)  # where the joints are at power-up
HOME = (REACH, 0.0, 0.0)  # and where each is when its switch closes
TRAVEL = (REACH, 360.0, 50.0)  # how far it is to a switch at the most
CENTRED = (0, 1)  # axes of space whose travel ($130, $131) goes to either side of 0
FASTEST = 6000.0  # mm/min: no motion is faster, G0 included


def inverse(place, joints):
    """Fill in the joints for a place. They hold where they are before. False: out of reach."""
    x, y = place[0], place[1]
    radius = math.sqrt(x * x + y * y)
    if radius > REACH:
        return False
    if radius > 0:  # in the middle the table stays as it is
        turned = math.degrees(math.atan2(y, x)) - joints[1]
        joints[1] += turned - 360 * math.floor(turned / 360 + 0.5)  # the shorter way round
    joints[0] = radius
    joints[2] = place[2]
    return True


def forward(joints, place):
    """Fill in the place for these joints."""
    angle = math.radians(joints[1])
    place[0] = joints[0] * math.cos(angle)
    place[1] = joints[0] * math.sin(angle)
    place[2] = joints[2]
