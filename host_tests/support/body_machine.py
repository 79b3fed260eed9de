"""A simulated machine with a body of its own, whatever its settings say: pitch, ends and wiring.

Run as a program it is `ugrbl sim --stdio` for that body; options are a line of JSON: "settings", a
file; "board", if it is not the simulator's, a name or a file; "steps_per_mm" and "travel_mm" of
each axis as it is built; "swapped", letters of motors that are wired the other way round; "ruler",
a file with the tool's real position in mm, and its time. The tool begins in the middle. Switches
are at both ends of each axis. What the probe touches, if it is there: "surface", its height in the
middle and rise per mm along X and Y; "block", its left front corner; "hole", its middle and half
its width.
"""

import json
import sys
import threading
import time
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ugrbl.run import machine
from ugrbl.run.live import LiveLink
from ugrbl.run.pty_link import Stdio
from ugrbl.sim.motor_names import AXIS_LETTERS

_RULER_S = 0.05


class Body:
    """What is bolted together: it knows pins and nothing of settings."""

    def __init__(self, rig: Any, options: "dict[str, Any]") -> None:
        from ugrbl.sim.engine import Switch

        self._rig = rig
        self.per_mm = options["steps_per_mm"]
        self._ways = [-1 if x in options["swapped"] else 1 for x in AXIS_LETTERS]
        for axis, travel in enumerate(options["travel_mm"]):
            steps = int(travel / 2 * self.per_mm[axis])
            pin = rig.port.limit_names[axis]
            rig.engine.switches.append(Switch(pin, axis, True, steps))
            rig.engine.switches.append(Switch(pin, axis, False, -steps))

        rig.engine.switches.extend(_things(self, options))

    def place_mm(self) -> "list[float]":
        """Where the tool really is, from the middle."""
        steps = array("i", [0] * len(self.per_mm))
        self._rig.engine.physical(steps)
        return [w * s / per for w, s, per in zip(self._ways, steps, self.per_mm, strict=False)]


_NOWHERE_MM = 1e6


def _things(body: Body, options: "dict[str, Any]") -> "list[Any]":
    """What the probe may touch, as switches of the motors that bring it there."""
    from ugrbl.sim.engine import Switch

    class Side(Switch):
        """Where it is hangs on where the other axes are. mm: called with that place."""

        def __init__(self, axis: int, above: bool, mm: "Callable[[list[float]], float]") -> None:
            super().__init__("probe", axis, above, 0)
            self._mm = mm

        @property
        def steps(self) -> int:
            return round(self._mm(body.place_mm()) * body.per_mm[self.axis])

        @steps.setter
        def steps(self, steps: int) -> None:
            """The thing says where it is."""

    found: "list[Any]" = []
    if plane := options.get("surface"):
        found.append(Side(2, False, lambda at: plane[0] + plane[1] * at[0] + plane[2] * at[1]))
    if block := options.get("block"):
        for axis in (0, 1):
            found.append(Side(axis, True, _beside(block, axis)))
    if hole := options.get("hole"):
        for axis in (0, 1):
            for way in (1, -1):
                place = hole[axis] + way * hole[2]
                found.append(Side(axis, way > 0, lambda at, place=place: place))
    return found


def _beside(block: "list[float]", axis: int) -> "Callable[[list[float]], float]":
    """A side of the block, where the tool is beside it."""
    other = 1 - axis
    return lambda at: block[axis] if at[other] >= block[other] else _NOWHERE_MM


def main() -> None:
    """Until stdin ends."""
    options = json.loads(sys.argv[1])
    wire = Stdio()
    rig = machine.build(
        options.get("board", "sim"),
        lambda rig: LiveLink(rig, wire, fast=False),
        Path(options["settings"]),
    )
    body, ruler = Body(rig, options), Path(options["ruler"])

    def measure() -> None:
        while True:
            whole = ruler.with_suffix(".new")
            whole.write_text(json.dumps({"time": time.time(), "mm": body.place_mm()}))
            whole.replace(ruler)
            time.sleep(_RULER_S)

    threading.Thread(target=measure, daemon=True).start()
    machine.run(rig)


if __name__ == "__main__":
    main()
