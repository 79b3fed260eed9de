"""Tool change by hand, each tool measured at a sensor: M6 T2. The sensor is the PROBE input.

Lengths are those of G43.1, and kept with the tool, so they hold after a reset or power-off. A tool
that has not been measured counts as the longest possible one, and stays clear of the work.
"""

from ugrbl import Refuse, on

SENSOR, CHANGE = "X3 Y139", "X3 Y60"  # its place; where hands reach it; machine coordinates
TOP, LOWEST = -1, -60  # Z: clear of everything; a tool must touch before this
SPIN_DOWN_S = 4


def measure(m):
    m.set_length(0)
    with m.saved():
        m.g("G53 G0 Z%d" % TOP)
        m.g("G53 G0 " + SENSOR)
        rough = m.probe("G53 Z%d F400" % LOWEST)
        m.g("G53 G0 Z%.3f" % (rough.z + 2))
        m.keep["length"] = m.probe("G53 Z%d F50" % LOWEST).z
        m.g("G53 G0 Z%d" % TOP)
    m.set_length(m.keep["length"])


@on.tool_change
def change(m, tool):
    if m.touches():
        raise Refuse("The tool sensor is pressed: nothing has moved")
    was_turning = "M5" not in m.modes()
    m.g("M5 M9")
    m.wait(SPIN_DOWN_S if was_turning else 0)
    with m.saved():
        m.g("G53 G0 Z%d\nG53 G0 %s" % (TOP, CHANGE))
    m.ask("Put in tool %d, then cycle start" % tool)
    measure(m)


@on.startup
@on.after_reset
@on.after_unlock
@on.after_homing
def restore(m):
    if "length" in m.keep and m.state == "Idle":
        m.set_length(m.keep["length"])
