"""Block layout: the places in a block, and the meaning of its numbers.

Constants only. A block begins with the modal state as its line would set it. The line's other
requests follow, and its numbers are in separate arrays.
"""

from control.modes import MODAL_LENGTH
from micropython import const

# Motion modes: the G number; for probes, G38.n, it is 138 + 10 n. Extras' are between NO_MOTION
# and the probes.
SEEK = const(0)
LINEAR = const(1)
CW_ARC = const(2)
CCW_ARC = const(3)
NO_MOTION = const(80)
PROBE_TOWARD = const(158)  # G38.2
PROBE_TOWARD_NO_ALARM = const(168)
PROBE_AWAY = const(178)
PROBE_AWAY_NO_ALARM = const(188)

# Non-modal commands.
NO_ACTION = const(0)
DWELL = const(4)
SET_COORDS = const(10)
GO_G28 = const(28)
GO_G30 = const(30)
SET_G28 = const(38)
SET_G30 = const(40)
ABSOLUTE_OVERRIDE = const(53)
SET_G92 = const(92)
RESET_G92 = const(102)

# Program flow.
RUNNING = const(0)
PAUSED = const(1)
END_M2 = const(2)
END_M30 = const(30)

# AXIS_USE: which command uses the line's axis words.
AXES_UNUSED = const(0)
AXES_FOR_COMMAND = const(1)  # a non-modal one: G10, G28, G30, G92
AXES_FOR_MOTION = const(2)
AXES_FOR_LENGTH = const(3)  # the tool length: G43.1, G49

# Places in Block.ints, after the modal state as the line would set it:
COMMANDS = const(MODAL_LENGTH)  # mask of the modal groups of the line's words
WORDS = const(MODAL_LENGTH + 1)  # mask of the line's value words
NON_MODAL = const(MODAL_LENGTH + 2)
AXIS_USE = const(MODAL_LENGTH + 3)  # AXES_…
INDEX = const(MODAL_LENGTH + 4)  # the coordinate system that G10 writes
ONLY = const(MODAL_LENGTH + 5)  # not 0: the line must request exactly this, with or without S

# Requests of a checked block, a bit each: see checks.check().
SPEED = const(0x001)  # another S
SET_TOOL = const(0x002)
ACCESSORIES = const(0x004)  # spindle, coolant or override control by M words
OFFSETS = const(0x008)  # another tool length or coordinate system
COMMAND = const(0x010)  # a non-modal command
MOVE = const(0x020)
FLOW = const(0x040)
NOT_STRAIGHT = const(0x080)  # with MOVE: an arc, a probe, or an extra's motion
# Laser mode: the line's effect on the beam.
BEAM_OFF = const(0x100)  # not a cutting motion: power 0 in this line, whatever S is
S_IN_MOTION = const(0x200)  # S takes effect with the motion, not before it
BEAM_SWITCHES = const(0x400)  # on or off without motion: S is set again, after all motion
CHECKED = const(0x800)  # always set

# Places in Interpreter.machine, for kernels.
AXES = const(0)  # the number of axes
LENGTHS = const(1)  # mask of axes whose numbers are in mm or inches
LENGTH_AXIS = const(2)  # the axis of the tool length
IS_OPEN = const(3)  # 1: kernels may execute lines
WATCHED = const(4)  # mask of requests that need Python before a line is executed
LINES_LEFT = const(5)  # how many lines may be executed before the loop's next turn
ASKED = const(6)  # the last result of check(), 0 if there is none for this line
MACHINE_LENGTH = const(7)

# Numbers of a line: places in Block.singles. Axis words are in Block.xyz.
I = const(0)  # noqa: E741 (the letter of the word); J and K follow
F = const(3)
L = const(4)
N = const(5)
P = const(6)
R = const(7)
S = const(8)
T = const(9)
TOOL_LIMIT = const(10)  # constants: the highest tool number,
INCH_MM = const(11)  # and 25.4
SCRATCH = const(12)
SINGLES = const(13)

# Modal groups, as bits of COMMANDS. The names are the standard's.
GROUP_0 = const(0x0001)  # non-modal
GROUP_1 = const(0x0002)  # motion
GROUP_2 = const(0x0004)  # plane
GROUP_3 = const(0x0008)  # distance
GROUP_4 = const(0x0010)  # arc distance
GROUP_5 = const(0x0020)  # feed rate
GROUP_6 = const(0x0040)  # units
GROUP_7 = const(0x0080)  # cutter compensation
GROUP_8 = const(0x0100)  # tool length
GROUP_12 = const(0x0200)  # coordinate system
GROUP_13 = const(0x0400)  # path control
GROUP_M4 = const(0x0800)  # program flow
GROUP_M7 = const(0x1000)  # spindle
GROUP_M8 = const(0x2000)  # coolant
GROUP_M9 = const(0x4000)  # override control

# Value words, as bits of WORDS, in the order of block.VALUE_LETTERS. X, Y, Z, A, B, C are first,
# one bit per axis.
AXIS_WORDS = const(0x003F)
WORD_I = const(0x0040)
WORD_IJK = const(0x01C0)
WORD_F = const(0x0200)
WORD_L = const(0x0400)
WORD_N = const(0x0800)
WORD_P = const(0x1000)
WORD_R = const(0x2000)
WORD_S = const(0x4000)
WORD_T = const(0x8000)
MOTION_WORDS = const(WORD_IJK | WORD_L | WORD_P | WORD_R)  # allowed in an extra's motion mode
HIGHEST_TOOL = const(255)
