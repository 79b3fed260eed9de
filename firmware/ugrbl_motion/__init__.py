"""Motion for programs of your own: axes, a queue of moves, outputs in step with them; no G-code.

    from ugrbl_motion import Axis, Group

    x = Axis(2, 5, steps_per_unit=80, speed=100, acceleration=500)
    table = Group(x=x)
    table.move(x=10)
    table.wait()

It is the engine of ugrbl: planner, segments, PIO or RMT, wired without the G-code machine. Units
are those of the program (mm, degrees, seconds of arc) and seconds. docs/engine.md describes it.
"""

from ugrbl_motion.group import Axis, Group, GroupError, Output

__all__ = ["Axis", "Group", "GroupError", "Output"]
