"""A tool table: G10 L1 P3 Z-12.5 enters tool 3, G43 H3 uses its length, M6 asks for the tool.

G43 alone uses the length of the tool in the spindle, and G49 cancels it. The entries, and the tool
in the spindle, are kept over power-off. M6 is refused if its tool has no length; afterwards the
length is in force. G43 H3 Z5 also moves to Z5, in the mode that holds, G0 or G1.
"""

from ugrbl import Refuse, gcode, on

CHANGE_AT = "G53 G0 X3 Y3"  # machine coordinates, where a hand reaches the spindle
CLEAR = "G53 G0 Z-1"


def length(m, tool):
    if "tool%d" % tool not in m.keep:
        raise Refuse("tool %d has no length: G10 L1 P%d Z and the length" % (tool, tool))
    return m.keep["tool%d" % tool]


@gcode("10 L1", "PZ")
def enter(m, P, Z):
    if P < 1 or P != int(P):
        raise Refuse("tools are numbered from 1")
    m.keep["tool%d" % P] = m.mm(Z)


@gcode(43, "hz", sync=None)
def use(m, H=None, Z=None):
    m.set_length(length(m, m.keep.get("in", 0) if H is None else H))
    if Z is not None:
        m.g("Z%.4f" % Z)


@on.tool_change
def change(m, tool):
    mm = length(m, tool)  # refuses before anything moves
    if tool != m.keep.get("in", 0):
        m.g("M5 M9")
        with m.saved():
            m.g(CLEAR)
            m.g(CHANGE_AT)
        m.ask("put in tool %d" % tool)
        m.keep["in"] = tool
    m.set_length(mm)
