"""A simulated machine with a body of its own, whatever its settings say: pitch, ends and wiring.

Run as a program it is `ugrbl sim --stdio` for that body; options are a line of JSON: "settings", a
file; "steps_per_mm" and "travel_mm" of each axis as it is built; "swapped", letters of motors that
are wired the other way round; "ruler", a file in which it says where the tool really is, in mm,
and when. The tool begins in the middle. Switches are at both ends of each axis.
"""

import json
import sys
import threading
import time
from array import array
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
        self._per_mm = options["steps_per_mm"]
        self._ways = [-1 if x in options["swapped"] else 1 for x in AXIS_LETTERS]
        for axis, travel in enumerate(options["travel_mm"]):
            steps = int(travel / 2 * self._per_mm[axis])
            pin = rig.port.limit_names[axis]
            rig.engine.switches.append(Switch(pin, axis, True, steps))
            rig.engine.switches.append(Switch(pin, axis, False, -steps))

    def place_mm(self) -> "list[float]":
        """Where the tool really is, from the middle."""
        steps = array("i", [0] * len(self._per_mm))
        self._rig.engine.physical(steps)
        return [w * s / per for w, s, per in zip(self._ways, steps, self._per_mm, strict=False)]


def main() -> None:
    """Until stdin ends."""
    options = json.loads(sys.argv[1])
    wire = Stdio()
    rig = machine.build(
        "sim", lambda rig: LiveLink(rig, wire, fast=False), Path(options["settings"])
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
