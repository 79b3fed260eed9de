"""A rack of eight tools, a spindle with a drawbar, and a sensor that measures lengths: T3 M6.

OUTPUTS = {"drawbar": 20, "blow": 21} and INPUTS = {"tool_in": 10, "open": 11, "air": 12} in the
board file. The inputs mean: a tool is in the cone; the drawbar is open; the air has its pressure.
The drawbar opens by air and closes by its spring, so every stop of the machine closes it. T0 M6
puts the tool away. After an interrupted change M61 Q3 says which tool is in the spindle.
"""

from ugrbl import Refuse, mcode, on

TOOLS = 8
FIRST_X, FIRST_Y, PITCH = 20.0, 300.0, 40.0  # pockets are along X; all in machine coordinates
TOP, ABOVE, IN_POCKET = -1.0, -60.0, -80.0  # Z: clear of all; a tool above its pocket; in it
SENSOR, LOWEST = "X360 Y300", -75  # Z: a tool must touch before this
SLOW, SPIN_DOWN_S, AIR_S, BLOW_S = 600, 6, 2, 0.4
BROKEN_MM = 0.5  # a tool that has become this much shorter is broken


def ready(m, tool):
    """Refuse a change, before anything moves, for any reason; return the tool in the spindle."""
    there = m.keep.get("tool", 0)
    if tool > TOOLS:
        raise Refuse("The rack has tools 1 to %d, not %d" % (TOOLS, tool))
    if not m.pin("air"):
        raise Refuse("The drawbar has no air")
    if m.pin("open"):
        raise Refuse("The drawbar stands open")
    if m.touches():
        raise Refuse("The length sensor is pressed")
    if m.pin("tool_in") != (there > 0):
        seen = "has a tool" if m.pin("tool_in") else "is empty"
        raise Refuse("The spindle %s, and should have tool %d: M61 Q says which" % (seen, there))
    return there


def drawbar(m, is_open):
    m.out("drawbar", is_open)
    if not m.wait_for("open", is_open, seconds=AIR_S):
        m.stop("The drawbar does not %s" % ("open" if is_open else "close"))


def over(m, tool):
    m.g("G53 G0 Z%g" % TOP)
    m.g("G53 G0 X%g Y%g" % (FIRST_X + (tool - 1) * PITCH, FIRST_Y))


def down(m):
    m.g("G53 G0 Z%g" % ABOVE)
    m.g("G53 G1 Z%g F%d" % (IN_POCKET, SLOW))
    m.wait_motion()


def up(m):
    m.g("G53 G1 Z%g F%d" % (ABOVE, SLOW))
    m.g("G53 G0 Z%g" % TOP)
    m.wait_motion()


def put_away(m, tool):
    over(m, tool)
    down(m)
    drawbar(m, True)
    up(m)
    if m.pin("tool_in"):
        m.stop("Tool %d has not stayed in its pocket" % tool)
    m.keep["tool"] = 0
    drawbar(m, False)


def fetch(m, tool):
    over(m, tool)
    drawbar(m, True)
    m.out("blow", True)  # chips out of the cone
    m.wait(BLOW_S)
    m.out("blow", False)
    down(m)
    drawbar(m, False)
    if not m.pin("tool_in"):
        m.stop("No tool in pocket %d" % tool)
    m.keep["tool"] = tool
    up(m)


def measure(m, tool):
    m.g("G53 G0 " + SENSOR)
    rough = m.probe("G53 Z%d F400" % LOWEST)
    m.g("G53 G0 Z%.3f" % (rough.z + 2))
    length = m.probe("G53 Z%d F50" % LOWEST).z
    m.g("G53 G0 Z%g" % TOP)
    last = m.keep.get("length%d" % tool, length)
    if length < last - BROKEN_MM:
        m.ask(
            "Tool %d is %.2f mm shorter than it was: cycle start goes on" % (tool, last - length)
        )
    m.keep["length%d" % tool] = length
    m.set_length(length)


@on.tool_change
def change(m, tool):
    there = ready(m, tool)
    if tool == there:
        return
    was_turning = "M5" not in m.modes()
    m.g("M5 M9")
    m.wait(SPIN_DOWN_S if was_turning else 0)
    m.set_length(0)
    with m.saved():
        if there:
            put_away(m, there)
        if tool:
            fetch(m, tool)
            measure(m, tool)


@mcode(61, "Q")
def tool_is(m, Q):
    if Q not in range(TOOLS + 1) or m.pin("tool_in") != (Q > 0):
        raise Refuse("M61 Q%g is not what the sensor of the spindle says" % Q)
    m.keep["tool"] = int(Q)
    restore(m)


@on.spindle
def no_tool(m, word, rpm):
    if word != "M5" and not m.pin("tool_in"):
        m.stop("%s without a tool" % word)


@on.startup
@on.after_reset
@on.after_unlock
@on.after_homing
def restore(m):
    if m.state == "Idle":
        m.set_length(m.keep.get("length%d" % m.keep.get("tool", 0), 0))
