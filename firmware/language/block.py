# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""Block: reads the words of one line into a block.

Steps one and two of the interpreter: copy the modal state, then store word after word. Refuses
errors of single words: unknown ones, two of a modal group, a repeated one.
"""

from array import array

import micropython
from base import errors
from base.float32 import f32, truncate, vector
from control import modes as mode
from micropython import const
from motion.arc_geometry import Arc

from language import block_layout as b
from language.words import LINE_LENGTH, Words, scan

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    ReadOn = Callable[[bytearray, int, int, object], int]

assert b.ONLY < mode.MODAL_ROOM, "the modal state is full: enlarge MODAL_ROOM"

_BEYOND = 2147483648.0  # 2**31: what a 32-bit integer cannot hold

# Value words, in the order of their bits.
VALUE_LETTERS = b"XYZABCIJKFLNPRST"
_NOT_NEGATIVE = const(0xDA00)  # F, N, P, S, T
_A = const(65)  # letters
_G = const(71)
_M = const(77)
_BIT_C = const(5)  # bits of WORDS: the last axis word; then I, the first of Block.singles, to T
_BIT_I = const(6)
_BIT_T = const(15)

# The dictionary of words, in bytes, for store_words(). The index has the number of a word's row by
# its code, M words after G words, and then the bit of each letter from A on. Each block has its
# own index, because boards differ.
M_WORDS = const(100)  # place in the index of M0; before it those of G0 to G99
_INDEXED = const(160)  # place in the index of letter A; before it those of M0 to M59
_NO_LETTER = const(255)  # in place of the bit: the machine has no such word
ROW = const(6)  # bytes of a row
# Places in a row. The first is the place in Modes.modal, or NOWHERE.
SETTING = const(1)  # value to store there, or in NON_MODAL
_AXIS_USE = const(2)  # use of the axis words: AXES_…
_DECIMALS = const(3)  # allowed decimals: bit n for .n
GROUP = const(4)  # two bytes
NOWHERE = const(255)  # in place of a place: the word sets none
# Bits of _DECIMALS.
OTHERS = const(0x80)  # the error of other decimals is "unsupported", not "no whole number"
NEEDED = const(0x40)  # a decimal is required
TENTHS = const(0x3F)  # bit n: .n is allowed

index = bytearray(_INDEXED) + b"\xff" * 26  # rows of G0 to G99, M0 to M59; bits of A to Z
dictionary = bytearray(ROW)  # row 0 means no word


def add_word(
    at: int, group: int, place: int, setting: int, axis_use: int = b.AXES_UNUSED, decimals: int = 0
) -> None:
    """Add a word to the dictionary.

    at: its G number, or M_WORDS plus its M number. group: a bit of block_layout.py. place: the
    modal state's place that it sets, or NOWHERE. setting: the value set there; of GROUP_0, in
    NON_MODAL. axis_use, decimals: see _AXIS_USE and _DECIMALS.
    """
    index[at] = len(dictionary) // ROW
    dictionary.extend(bytes((place, setting, axis_use, decimals, group & 255, group >> 8)))


# Calls, because constant rows would stay in memory in addition to the dictionary.
add_word(0, b.GROUP_1, mode.MOTION, b.SEEK, b.AXES_FOR_MOTION)
add_word(1, b.GROUP_1, mode.MOTION, b.LINEAR, b.AXES_FOR_MOTION)
add_word(2, b.GROUP_1, mode.MOTION, b.CW_ARC, b.AXES_FOR_MOTION)
add_word(3, b.GROUP_1, mode.MOTION, b.CCW_ARC, b.AXES_FOR_MOTION)
add_word(4, b.GROUP_0, NOWHERE, b.DWELL)
add_word(10, b.GROUP_0, NOWHERE, b.SET_COORDS, b.AXES_FOR_COMMAND)
add_word(17, b.GROUP_2, mode.PLANE, 0)
add_word(18, b.GROUP_2, mode.PLANE, 1)
add_word(19, b.GROUP_2, mode.PLANE, 2)
add_word(20, b.GROUP_6, mode.INCHES, 1)
add_word(21, b.GROUP_6, mode.INCHES, 0)
add_word(28, b.GROUP_0, NOWHERE, b.GO_G28, b.AXES_FOR_COMMAND, OTHERS | 0b10)
add_word(30, b.GROUP_0, NOWHERE, b.GO_G30, b.AXES_FOR_COMMAND, OTHERS | 0b10)
add_word(38, b.GROUP_1, mode.MOTION, 38, b.AXES_FOR_MOTION, OTHERS | NEEDED | 0b111100)
add_word(40, b.GROUP_7, NOWHERE, 0)
add_word(43, b.GROUP_8, mode.TOOL_LENGTH, 1, b.AXES_FOR_LENGTH, OTHERS | NEEDED | 0b10)
add_word(49, b.GROUP_8, mode.TOOL_LENGTH, 0, b.AXES_FOR_LENGTH)
add_word(53, b.GROUP_0, NOWHERE, b.ABSOLUTE_OVERRIDE)
add_word(54, b.GROUP_12, mode.SYSTEM, 0)
add_word(55, b.GROUP_12, mode.SYSTEM, 1)
add_word(56, b.GROUP_12, mode.SYSTEM, 2)
add_word(57, b.GROUP_12, mode.SYSTEM, 3)
add_word(58, b.GROUP_12, mode.SYSTEM, 4)
add_word(59, b.GROUP_12, mode.SYSTEM, 5)
add_word(61, b.GROUP_13, NOWHERE, 0, b.AXES_UNUSED, OTHERS)
add_word(80, b.GROUP_1, mode.MOTION, b.NO_MOTION)
add_word(90, b.GROUP_3, mode.RELATIVE, 0, b.AXES_UNUSED, OTHERS)
add_word(91, b.GROUP_3, mode.RELATIVE, 1, b.AXES_UNUSED, OTHERS | 0b10)
add_word(92, b.GROUP_0, NOWHERE, b.SET_G92, b.AXES_FOR_COMMAND, OTHERS | 0b10)
add_word(93, b.GROUP_5, mode.INVERSE_TIME, 1)
add_word(94, b.GROUP_5, mode.INVERSE_TIME, 0)
add_word(M_WORDS + 0, b.GROUP_M4, mode.PROGRAM_FLOW, b.PAUSED)
# Optional stop: no input for it, so it is ignored.
add_word(M_WORDS + 1, b.GROUP_M4, mode.PROGRAM_FLOW, b.RUNNING)
add_word(M_WORDS + 2, b.GROUP_M4, mode.PROGRAM_FLOW, b.END_M2)
add_word(M_WORDS + 30, b.GROUP_M4, mode.PROGRAM_FLOW, b.END_M30)
add_word(M_WORDS + 3, b.GROUP_M7, mode.SPINDLE, 0x10)
add_word(M_WORDS + 4, b.GROUP_M7, mode.SPINDLE, 0x20)
add_word(M_WORDS + 5, b.GROUP_M7, mode.SPINDLE, 0)
add_word(M_WORDS + 7, b.GROUP_M8, mode.COOLANT, 2)
add_word(M_WORDS + 8, b.GROUP_M8, mode.COOLANT, 1)
add_word(M_WORDS + 9, b.GROUP_M8, mode.COOLANT, 0)
add_word(M_WORDS + 56, b.GROUP_M9, mode.OVERRIDE_CONTROL, 1)
for _bit in range(len(VALUE_LETTERS)):
    index[_INDEXED + VALUE_LETTERS[_bit] - _A] = _bit


def decimals_of(at: int) -> int:
    """Return the allowed decimals of a word, -1 if there is no such word; at: as in add_word()."""
    row = index[at] if at < _INDEXED else 0  # a row's number, 0 if there is none
    return dictionary[row * ROW + _DECIMALS] if row else -1


@micropython.viper
def byte(value: int, top: int) -> int:
    """Return a float as a whole number from 0 to 255, or 256 if it is not one.

    value: its bits; top: the highest byte of these, above 127 if the float is negative.
    """
    # 127 is the exponent of 1, 134 that of 128 to 255; with 150 the mantissa is the number.
    exponent = (value >> 23) & 255
    # Negative, above 255, or below 1 and not 0.
    if top > 127 or exponent > 134 or (exponent < 127 and exponent):
        return 256
    number = ((value & 0x7FFFFF) | 0x800000) if exponent else 0
    shift = (150 - exponent) & 31  # masked, because the exponent of 0 is 0
    return number >> shift if (number >> shift) << shift == number else 256


@micropython.viper
def enter(place: int, setting: int, axis_use: int, group: int, ints: ptr32) -> int:
    """Store a G or M word in a block's ints. Returns Grbl's error number, or 0.

    place, setting, axis_use, group: from the word's row of the dictionary, see add_word(). The
    error is that of a second word of a modal group, or a second one that uses the axis words.
    """
    if axis_use:
        if ints[b.AXIS_USE]:
            return errors.GCODE_AXIS_COMMAND_CONFLICT
        ints[b.AXIS_USE] = axis_use
    if group == b.GROUP_0:
        ints[b.NON_MODAL] = setting
    elif place != NOWHERE:
        if group == b.GROUP_M8 and setting:
            setting |= ints[place]  # M7 and M8 add up
        ints[place] = setting
    if ints[b.COMMANDS] & group:
        return errors.GCODE_MODAL_GROUP_VIOLATION
    ints[b.COMMANDS] = ints[b.COMMANDS] | group
    return 0


@micropython.viper
def store_words(
    letters: ptr8,
    values: ptr32,
    count: int,
    index: ptr8,
    words: ptr8,
    ints: ptr32,
    xyz: ptr32,
    singles: ptr32,
    store_rare: object,
) -> int:
    """Store words in their order. Returns Grbl's error number of the first wrong one, or 0.

    letters, values: count words, as of words.scan(). index, words: Block._index, Block._rows.
    ints, xyz, singles: the block's. store_rare: a function that stores word i, a G or M word that
    `byte` cannot read, or that needs decimals.
    """
    error = 0
    i = 0
    while i < count and error == 0:
        letter = letters[i]
        value = values[i]
        top = ptr8(values)[4 * i + 3]  # the sign is its highest bit
        if letter == _G or letter == _M:  # noqa: PLR1714 (a viper cannot ask `in`)
            code = int(byte(value, top))
            if letter == _M:
                code += M_WORDS
            row = 0  # first byte of the word's row; 0: unknown, or `byte` cannot read it
            if code < (_INDEXED if letter == _M else M_WORDS):
                row = ROW * index[code]
            if row == 0 or words[row + _DECIMALS] & NEEDED:
                error = int(store_rare(i))  # type: ignore[operator]
            else:
                setting = words[row + SETTING]
                group = words[row + GROUP] | (words[row + GROUP + 1] << 8)
                error = int(enter(words[row], setting, words[row + _AXIS_USE], group, ints))
        else:
            bit = index[_INDEXED + letter - _A]  # of WORDS
            if bit == _NO_LETTER:
                return errors.GCODE_UNSUPPORTED_COMMAND
            if bit <= _BIT_C:  # an axis
                xyz[bit] = value
            else:
                singles[bit - _BIT_I] = value
            # Floats that are not negative compare as their bits do.
            if bit == _BIT_T and top < 128 and value > singles[b.TOOL_LIMIT]:
                error = errors.GCODE_MAX_VALUE_EXCEEDED
            elif (ints[b.WORDS] >> bit) & 1:
                error = errors.GCODE_WORD_REPEATED
            # Negative: the sign bit is set, and another bit is, because -0 is 0.
            elif (_NOT_NEGATIVE >> bit) & 1 and top > 127 and (top > 128 or value & 0xFFFFFF):
                error = errors.NEGATIVE_VALUE
            ints[b.WORDS] = ints[b.WORDS] | (1 << bit)
        i += 1
    return error


@micropython.viper
def read(
    line: object,
    span: int,
    modal: ptr32,
    ints: ptr32,
    singles: ptr32,
    xyz: ptr32,
    axes: int,
    words: object,
) -> int:
    """Copy a modal state, and store the words of line[start:end], where line[end] is 0.

    span: end << 8 | start. ints, singles, xyz: those of a block; words: Block.words. Returns
    Grbl's error number of the first wrong word, or 0.
    """
    # read_on: an extra's kernel that reads other text, or None; own: what it is passed.
    _letters, _values, index, rows, read_on, own, store_rare = words
    letters = ptr8(_letters)
    values = ptr32(_values)
    _begin(ints, xyz, axes, singles, modal)
    # Its result: the count of words, an error number << 8, the index of other text << 16.
    scanned = int(scan(ptr8(line), span, letters, values))
    if scanned >> 8 and read_on:  # an error, unless the extra can read what follows
        scanned = int(read_on(line, span, scanned, own))
    count = scanned & 255
    error = int(
        store_words(
            letters, values, count, ptr8(index), ptr8(rows), ints, xyz, singles, store_rare
        )
    )
    # The error of a word comes before that of the text after all words.
    return error if error else scanned >> 8 & 255


@micropython.viper
def _begin(ints: ptr32, xyz: ptr32, axes: int, singles: ptr32, modal: ptr32) -> int:
    """Clear a block and copy the modal state into its ints. singles: the numbers of words that
    are no axis words. Returns 0."""
    for i in range(axes):
        xyz[i] = 0
    for i in range(b.TOOL_LIMIT):  # from there on are constants, which no line changes
        singles[i] = 0
    for i in range(mode.MODAL_ROOM):  # after MODAL_LENGTH, modal is 0: that clears the rest
        ints[i] = modal[i]
    return 0


class Block:
    """The block of the line being interpreted. Reused for every line.

    letters: those of the machine's axes. ints, singles, xyz: the block's integers, numbers and
    axis words (block_layout.py). longest: most characters in a line.
    """

    def __init__(
        self,
        letters: bytes,
        has_mist: bool,
        has_override_control: bool,
        highest_tool: int = b.HIGHEST_TOOL,
        longest: int = LINE_LENGTH,
    ) -> None:
        self.ints = array("i", (0 for _ in range(mode.MODAL_ROOM)))
        self.axes = axes = len(letters)
        self.xyz = vector(axes)
        self.singles = vector(b.SINGLES)
        self.singles[b.TOOL_LIMIT], self.singles[b.INCH_MM] = highest_tool, 25.4
        # Results of the checks: the arc, and what G10 stores or where G28 and G30 go.
        self.arc = Arc()
        self.stored = vector(axes)
        self._words = Words(longest)
        # An extra's kernel for text that scan() cannot read, and an object for it. It is passed
        # line, span, the result of scan() and the object, and returns a new result as scan()'s. It
        # may set ONLY.
        self.read_on: "tuple[ReadOn | None, object]" = None, None
        self._index = bytearray(index)
        if not has_mist:
            self._index[M_WORDS + 7] = 0  # no M7
        if not has_override_control:
            self._index[M_WORDS + 56] = 0  # no M56
        # Axis words: only the machine's letters, whose bits are the axis numbers.
        for i in range(_BIT_I):
            self._index[_INDEXED + VALUE_LETTERS[i] - _A] = _NO_LETTER
        for i in range(axes):
            self._index[_INDEXED + letters[i] - _A] = i
        self._rows = dictionary

    @property
    def words(self) -> "tuple[object, ...]":
        """The last argument of read(): the words' letters and values, the dictionary, extras."""
        read, index, rows = self._words, self._index, self._rows
        read_on, own = self.read_on
        return read.letters, read.values, index, rows, read_on, own, self._store_rare

    def add_motion(self, number: int) -> None:
        """Add a G number as a motion mode, for every line that this block reads from now on."""
        self._index[number] = len(self._rows) // ROW
        # As add_word(), but in a copy of the dictionary, because other blocks share that.
        row = bytes((mode.MOTION, number, b.AXES_FOR_MOTION, 0, b.GROUP_1, 0))
        self._rows = self._rows + row

    def _store_rare(self, i: int) -> int:
        """Store the line's word i, a G or M word of any number, also with decimals. Returns Grbl's
        error number, or 0."""
        # As in Grbl, whose number is a byte: the rest is large for numbers above 255, and refused.
        value = self._words.values[i]
        number = truncate(value) & 255
        hundredths = _round(100 * f32(value - number))
        # The word's place in _index, and the end of the words of its letter there.
        at, end = number, M_WORDS
        if self._words.letters[i] == _M:
            if hundredths:
                return errors.GCODE_COMMAND_VALUE_NOT_INTEGER
            at, end = number + M_WORDS, _INDEXED
        row = self._index[at] if at < end else 0
        if not row:
            return errors.GCODE_UNSUPPORTED_COMMAND
        return self._enter_rare(self._rows[ROW * row :], number, hundredths)

    def _enter_rare(self, row: bytearray, number: int, hundredths: int) -> int:
        """Store a word with its row of the dictionary; its number is number + hundredths / 100.
        Returns Grbl's error number, or 0."""
        place, setting, axis_use, decimals = row[0], row[SETTING], row[_AXIS_USE], row[_DECIMALS]
        group = row[GROUP] | row[GROUP + 1] << 8
        if hundredths and axis_use == b.AXES_FOR_COMMAND:  # G28.1, G30.1, G92.1 use no axis words
            axis_use = b.AXES_UNUSED
            setting += hundredths  # .1: + 10, as SET_G28 is GO_G28 + 10
        if axis_use and self.ints[b.AXIS_USE]:
            return errors.GCODE_AXIS_COMMAND_CONFLICT
        if (hundredths and decimals & OTHERS) or decimals & NEEDED:
            # The row decides: one decimal, which it allows; else the word is unsupported.
            if hundredths % 10 or not (decimals & TENTHS) >> hundredths // 10 & 1:
                return errors.GCODE_UNSUPPORTED_COMMAND
            if number == 91:
                group, place = b.GROUP_4, NOWHERE  # G91.1: arc distance is always relative
            elif number == 38:
                setting += hundredths + 100  # 138 + 10 n for G38.n, as PROBE_TOWARD is 158
        elif hundredths and number != 49:  # those of G49 are ignored, as in Grbl
            return errors.GCODE_COMMAND_VALUE_NOT_INTEGER
        return enter(place, setting, axis_use, group, self.ints)


def _round(x: float) -> int:
    """Return x rounded, halves away from zero, modulo 2**16; 0xFFFF if 32 bits cannot hold it."""
    x = f32(x)
    if abs(x) >= _BEYOND:
        return 0xFFFF  # no word has such a number
    return (truncate(x + 0.5) if x >= 0 else -truncate(0.5 - x)) & 0xFFFF
