"""Block: the words of one line, taken in and given their places.

Step one and two of the interpreter: begin with a copy of the modal state, then
take in word after word. Refuses what is wrong with words as such: unknown
ones, two of a group, one repeated. Touches nothing but itself.
"""

from base import errors
from base.errors import GrblError
from base.f32 import f32, vector, whole
from control.modes import Modal
from micropython import const
from motion.arcs import Arc

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from language.words import Words

# Motion modes: the G number, for the probes G38.n the same with n * 10 + 100 added.
SEEK = const(0)
LINEAR = const(1)
CW_ARC = const(2)
CCW_ARC = const(3)
NO_MOTION = const(80)
PROBE_TOWARD = const(158)  # G38.2
PROBE_TOWARD_NO_ALARM = const(168)
PROBE_AWAY = const(178)
PROBE_AWAY_NO_ALARM = const(188)
CUTTING = (LINEAR, CW_ARC, CCW_ARC)

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

# Who uses the axis words.
AXES_UNCLAIMED = const(0)
AXES_NON_MODAL = const(1)
AXES_MOTION = const(2)
AXES_TOOL_LENGTH = const(3)

# Modal groups, as bits of `commands`. Names are the standard's.
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

# G number -> modal group, attribute of Modal it sets, if any, value, who claims the axis words.
G_WORDS = {  # attribute-names: column 1
    0: (GROUP_1, "motion", SEEK, AXES_MOTION),
    1: (GROUP_1, "motion", LINEAR, AXES_MOTION),
    2: (GROUP_1, "motion", CW_ARC, AXES_MOTION),
    3: (GROUP_1, "motion", CCW_ARC, AXES_MOTION),
    4: (GROUP_0, None, DWELL, AXES_UNCLAIMED),
    10: (GROUP_0, None, SET_COORDS, AXES_NON_MODAL),
    17: (GROUP_2, "plane", 0, AXES_UNCLAIMED),
    18: (GROUP_2, "plane", 1, AXES_UNCLAIMED),
    19: (GROUP_2, "plane", 2, AXES_UNCLAIMED),
    20: (GROUP_6, "inches", 1, AXES_UNCLAIMED),
    21: (GROUP_6, "inches", 0, AXES_UNCLAIMED),
    28: (GROUP_0, None, GO_G28, AXES_NON_MODAL),
    30: (GROUP_0, None, GO_G30, AXES_NON_MODAL),
    38: (GROUP_1, "motion", 38, AXES_MOTION),
    40: (GROUP_7, None, 0, AXES_UNCLAIMED),
    43: (GROUP_8, "tool_length", 1, AXES_TOOL_LENGTH),
    49: (GROUP_8, "tool_length", 0, AXES_TOOL_LENGTH),
    53: (GROUP_0, None, ABSOLUTE_OVERRIDE, AXES_UNCLAIMED),
    54: (GROUP_12, "system", 0, AXES_UNCLAIMED),
    55: (GROUP_12, "system", 1, AXES_UNCLAIMED),
    56: (GROUP_12, "system", 2, AXES_UNCLAIMED),
    57: (GROUP_12, "system", 3, AXES_UNCLAIMED),
    58: (GROUP_12, "system", 4, AXES_UNCLAIMED),
    59: (GROUP_12, "system", 5, AXES_UNCLAIMED),
    61: (GROUP_13, None, 0, AXES_UNCLAIMED),
    80: (GROUP_1, "motion", NO_MOTION, AXES_UNCLAIMED),
    90: (GROUP_3, "relative", 0, AXES_UNCLAIMED),
    91: (GROUP_3, "relative", 1, AXES_UNCLAIMED),
    92: (GROUP_0, None, SET_G92, AXES_NON_MODAL),
    93: (GROUP_5, "inverse_time", 1, AXES_UNCLAIMED),
    94: (GROUP_5, "inverse_time", 0, AXES_UNCLAIMED),
}

# G number -> the decimals it may have besides none, a bit for each tenth. Others are unsupported,
# where with any other G number they are malformed.
_G_DECIMALS = {
    28: 0b10,
    30: 0b10,
    38: 0b111100,
    43: 0b10,
    61: 0,
    90: 0,
    91: 0b10,
    92: 0b10,
}
_WANTS_DECIMALS = (38, 43)

# M number -> modal group, attribute of Modal, value.
M_WORDS = {  # attribute-names: column 1
    0: (GROUP_M4, "program_flow", PAUSED),
    1: (GROUP_M4, "program_flow", RUNNING),  # optional stop: there is no switch for it
    2: (GROUP_M4, "program_flow", END_M2),
    30: (GROUP_M4, "program_flow", END_M30),
    3: (GROUP_M7, "spindle", 0x10),
    4: (GROUP_M7, "spindle", 0x20),
    5: (GROUP_M7, "spindle", 0),
    7: (GROUP_M8, "coolant", 2),
    8: (GROUP_M8, "coolant", 1),
    9: (GROUP_M8, "coolant", 0),
    56: (GROUP_M9, "override_control", 1),
}
_M_MIST = const(7)
_M_OVERRIDE_CONTROL = const(56)

# Value words, as bits of `values` in Block. X, Y, Z, A come first, one bit per axis.
_VALUE_LETTERS = b"XYZAIJKFLNPRST"
AXIS_WORDS = const(0x000F)
WORD_I = const(0x0010)
WORD_IJK = const(0x0070)
WORD_F = const(0x0080)
WORD_L = const(0x0100)
WORD_N = const(0x0200)
WORD_P = const(0x0400)
WORD_R = const(0x0800)
WORD_S = const(0x1000)
WORD_T = const(0x2000)
_NOT_NEGATIVE = const(0x3680)  # F, N, P, S, T
HIGHEST_TOOL = const(255)
_BEYOND = 2147483648.0
_MANY = const(100000000)  # more than any line number


class Block:
    """One line being interpreted. Reused for every line."""

    def __init__(
        self,
        axes: int,
        has_mist: bool,
        has_override_control: bool,
        highest_tool: int = HIGHEST_TOOL,
    ) -> None:
        self._highest_tool = highest_tool
        self.modal = Modal()
        self.xyz = vector(axes)
        self.ijk = vector(3)
        # What the checks find: the arc, and what G10, G28 and G30 are to keep or go to.
        self.arc = Arc()
        self.stored = vector(axes)
        self._axes = axes
        self._unsupported_m = set()
        if not has_mist:
            self._unsupported_m.add(_M_MIST)
        if not has_override_control:
            self._unsupported_m.add(_M_OVERRIDE_CONTROL)
        self._values = {}
        for i in range(len(_VALUE_LETTERS)):
            self._values[_VALUE_LETTERS[i]] = 1 << i
        for i in range(axes, 4):
            del self._values[_VALUE_LETTERS[i]]
        self.begin(self.modal)

    def begin(self, modal: "Modal") -> None:
        """Forget the last line; start from that modal state."""
        if modal is not self.modal:
            self.modal.copy(modal)
        self.commands = 0
        self.values = 0
        self.non_modal = NO_ACTION
        self.claim = AXES_UNCLAIMED
        for i in range(self._axes):
            self.xyz[i] = 0.0
        for i in range(3):
            self.ijk[i] = 0.0
        self.f = 0.0
        self.l = 0
        self.n = 0
        self.p = 0.0
        self.r = 0.0
        self.s = 0.0
        self.t = 0

    def take(self, words: "Words") -> None:
        """Take in all words, in their order. Raises GrblError for the first that is wrong."""
        for i in range(words.count):
            letter = words.letters[i]
            value = words.values[i]
            if letter == 71:  # G
                self._take_g(value)
            elif letter == 77:  # M
                self._take_m(value)
            else:
                self._take_value(letter, value)
        if words.fault == 1:
            raise GrblError(errors.EXPECTED_COMMAND_LETTER)
        if words.fault:
            raise GrblError(errors.BAD_NUMBER_FORMAT)

    def _take_g(self, value: float) -> None:
        # The whole part is a byte; the rest, larger numbers included, counts as hundredths.
        code = whole(value) & 255
        hundredths = _round(100 * f32(value - code))
        row = G_WORDS.get(code)
        if row is None:
            raise GrblError(errors.GCODE_UNSUPPORTED_COMMAND)
        group, name, setting, claim = row
        is_store = claim == AXES_NON_MODAL and hundredths != 0  # G28.1, G30.1, G92.1
        if claim and not is_store:
            if self.claim:
                raise GrblError(errors.GCODE_AXIS_COMMAND_CONFLICT)
            self.claim = claim
        if (hundredths and code in _G_DECIMALS) or code in _WANTS_DECIMALS:
            if hundredths % 10 or not _G_DECIMALS[code] >> hundredths // 10 & 1:
                raise GrblError(errors.GCODE_UNSUPPORTED_COMMAND)
            if code == 91:
                group, name = GROUP_4, None  # G91.1: arc distance is always relative
            elif code == 38:
                setting += hundredths + 100
            elif is_store:
                setting += hundredths
        elif hundredths and code != 49:
            raise GrblError(errors.GCODE_COMMAND_VALUE_NOT_INTEGER)
        if group == GROUP_0:
            self.non_modal = setting
        elif name:
            setattr(self.modal, name, setting)
        self._claim_group(group)

    def _take_m(self, value: float) -> None:
        code = whole(value) & 255
        if _round(100 * f32(value - code)):
            raise GrblError(errors.GCODE_COMMAND_VALUE_NOT_INTEGER)
        row = M_WORDS.get(code)
        if row is None or code in self._unsupported_m:
            raise GrblError(errors.GCODE_UNSUPPORTED_COMMAND)
        group, name, setting = row
        if group == GROUP_M8 and setting:
            setting |= self.modal.coolant  # M7 and M8 add up
        setattr(self.modal, name, setting)
        self._claim_group(group)

    def _claim_group(self, group: int) -> None:
        if self.commands & group:
            raise GrblError(errors.GCODE_MODAL_GROUP_VIOLATION)
        self.commands |= group

    def _take_value(self, letter: int, value: float) -> None:
        bit = self._values.get(letter)
        if bit is None:
            raise GrblError(errors.GCODE_UNSUPPORTED_COMMAND)
        if bit == WORD_T and value > self._highest_tool:
            raise GrblError(errors.GCODE_MAX_VALUE_EXCEEDED)
        self._assign(letter, bit, value)
        if self.values & bit:
            raise GrblError(errors.GCODE_WORD_REPEATED)
        if bit & _NOT_NEGATIVE and value < 0:
            raise GrblError(errors.NEGATIVE_VALUE)
        self.values |= bit

    def _assign(self, letter: int, bit: int, value: float) -> None:
        if bit & AXIS_WORDS:
            self.xyz[letter - 88 if letter >= 88 else 3] = value
        elif bit & WORD_IJK:
            self.ijk[letter - 73] = value
        elif bit == WORD_L:
            self.l = whole(value) & 255
        elif bit == WORD_N:
            self.n = whole(min(value, _MANY))
        elif bit == WORD_T:
            self.t = whole(value) & 255
        else:
            setattr(self, chr(letter + 32), value)


def _round(x: float) -> int:
    """To the nearest whole number, halves away from zero, in 16 bits without sign."""
    x = f32(x)
    if abs(x) >= _BEYOND:
        return 0xFFFF
    return (whole(x + 0.5) if x >= 0 else -whole(0.5 - x)) & 0xFFFF
