"""A turntable scanner: it turns without a stop, and triggers a camera every 10 degrees."""

from ugrbl_motion import Axis, Group, Output

PICTURES = 36
# Units are degrees: 200 steps, 16 microsteps, a belt of 4 to 1.
turn = Axis(step=2, direction=5, steps_per_unit=200 * 16 * 4 / 360, speed=60, acceleration=120)
table = Group(turn=turn, camera=Output(15))

table.move_by(turn=10, speed=30)  # reach the speed before the first picture
for _ in range(PICTURES):
    table.move_by(turn=1, speed=30, camera=1)  # the trigger is on for 1 of the 10 degrees
    table.move_by(turn=9, speed=30, camera=0)
table.move_by(turn=10)
table.wait()
