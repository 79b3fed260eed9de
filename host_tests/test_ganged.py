"""Two motors on an axis: how they home, square themselves, and are all alive afterwards."""

from rig_bench import Machine
from ugrbl.sim.engine import Switch

_STEPS_PER_MM = 250
# Switches at the upper ends, in steps from where power comes on.
_AT = 2500
SETTINGS = {
    1: 255,
    22: 1,
    24: 300,
    25: 3000,
    26: 5,
    27: 1,
    110: 3000,
    111: 3000,
    112: 3000,
    120: 400,
    121: 400,
    122: 400,
}


class Gantry(Machine):
    """A machine with a switch at the end of each motor's way: the second of Y is `racked` steps
    further away from its own than the first."""

    def __init__(self, racked: int = 0, settings: "dict[int, float] | None" = None) -> None:
        super().__init__({**SETTINGS, **(settings or {})}, "sim_ganged", watched=False)
        for motor, pin in enumerate(("limit_x", "limit_y", "limit_z", "limit_y2")):
            at = _AT + (racked if motor == 3 else 0)
            self.rig.engine.switches.append(Switch(pin, motor, True, at))

    def say(self, *lines: str) -> "list[str]":
        self.play(lines)
        return self.received


if __name__ == "__main__":
    for racked in (0, 100, -300):
        g = Gantry(racked, {171: 0.2})
        print(g.say("$$", "$H", "?", "G91 G0 Y-2"))
        print(g.physical())
