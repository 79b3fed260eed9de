"""Check whether a board can process a program's lines as fast as its motors execute them.

The simulator's sender is never late, so its motion is the motion as planned. The time of each line
in this motion is compared with the time that a board needs to process it (boardfile/rates.py).
Lines count from 1; entry 0 is of lines that are not in the program. The kind of a line is how the
firmware processes it: the name of a field of Rates.
"""

import re
from array import array
from collections import defaultdict, deque
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from ..boardfile.rates import Intake, intake
from ..grbl.gcode_file import without_comments
from .recorder import Recorder, replace_method

if TYPE_CHECKING:
    from ..sim.rig import Rig

_WORD = re.compile(rb"([A-Z])([-+]?[\d.]*)")
_AXES = frozenset(b"XYZABC")
_LETTERS = _AXES | frozenset(b"GFSNT")
_STRAIGHT, _ARCS = (b"0", b"1"), (b"2", b"3")
_NO_WORDS, _PLAIN, _POWER, _IN_PYTHON = "no_words_ms", "plain", "power", "in_python_ms"
_CHORDS = "chords"
# Modal words, by group. A word that is already active changes nothing when repeated.
_GROUPS = [
    frozenset(group.split())
    for group in (
        *(b"G17 G18 G19", b"G20 G21", b"G40", b"G54 G55 G56 G57 G58 G59", b"G61"),
        *(b"G90 G91", b"G93 G94", b"M3 M4 M5", b"M7 M8 M9"),
    )
]
# A move-only line may contain these words, because kernels read them too.
_MEANINGS = frozenset(b"G17 G18 G19 G20 G21 G90 G91 G93 G94".split())
_AT_FIRST = frozenset(b"G17 G21 G40 G54 G61 G90 G94 M5 M9".split())  # active at power-up
_LEAST_S = 0.05  # the shortest wait that is reported
_APART = 100  # so many lines in time may be between two late ones of a stretch


@dataclass
class Stretch:
    """Lines, from 1, that come too fast for the board. lost_s: how long the motors wait for
    them."""

    first: int
    last: int
    needed: float  # lines per second, as `taken`
    taken: float
    lost_s: float
    kind: str  # the kind of line that takes most of the time: a field of Rates
    feed: int  # percent of the feed rate at which the board would be fast enough

    def as_json(self) -> dict[str, Any]:
        """Return the stretch for `ugrbl run --json`."""
        return asdict(self)


class Paced(Recorder):
    """A Recorder that also records the motion time and the number of blocks of each line."""

    def __init__(self, rig: "Rig") -> None:
        super().__init__(rig)
        self.ticks = array("q", [0])  # motion time by line, in ticks of the engine
        self.blocks = array("i", [0])
        self.from_rest: set[int] = set()  # lines before which motion had ended
        self._line_of_block: dict[int, int] = {}  # by row in the planner's ring
        self._line_of_row: dict[int, int] = {}  # by id of the engine's row
        self._segment_end = -1  # tick at which the last segment ended

    def _attach(self) -> None:
        super()._attach()
        hooks = self._rig.controller.state.hooks
        self._make_segment = replace_method(hooks, "next_segment", self._follow_segment)

    def _note(self, row: int) -> None:
        """Note a planned block, and count it for its line."""
        super()._note(row)
        line = self._rig.link.now_at()
        self._line_of_block[row] = line
        missing = line + 1 - len(self.blocks)
        if missing > 0:
            self.ticks.extend([0] * missing)
            self.blocks.extend([0] * missing)
        self.blocks[line] += 1

    def _follow_segment(self, row: "array[int]") -> int:
        """Replace Segments.next, and note the line that a segment belongs to."""
        has_segment = int(self._make_segment(row))
        if has_segment:
            flow, layout = self._planner.flow, self._layout
            block = flow[layout.BLOCK_AT] // flow[layout.ROW_SIZE]
            self._line_of_row[id(row)] = self._line_of_block.get(block, 0)
        return has_segment

    def _record_segment(self, start: int, row: "array[int]") -> None:
        """Record a segment, add its time to its line, and note a start from rest."""
        super()._record_segment(start, row)
        line = self._line_of_row.get(id(row), 0)
        self.ticks[line] += row[self._layout.ROW_TICKS]
        if start != self._segment_end:
            self.from_rest.add(line)
        self._segment_end = start + row[self._layout.ROW_TICKS]

    def intake(self) -> Intake:
        """Return the intake of this machine's board."""
        return intake(self._rig.board)

    def starves(self, lines: Sequence[bytes]) -> list[Stretch]:
        """Return the stretches for which this machine's board would be too slow, worst first."""
        if len(self.blocks) == 1:
            return []  # nothing has moved
        board_intake = self.intake()
        kinds = list(_kinds(lines, bool(self._rig.controller.settings.laser_mode)))
        late = self._late(lines, kinds, board_intake)
        stretches = [
            self._stretch(part, late, lines, kinds, board_intake) for part in _parts(late)
        ]
        stretches.sort(key=lambda stretch: -stretch.lost_s)
        return [stretch for stretch in stretches if stretch.lost_s >= _LEAST_S]

    def _late(
        self, lines: Sequence[bytes], kinds: Sequence[str], board_intake: Intake
    ) -> dict[int, float]:
        """Return the time in s that motion would wait for each late line, by its number.

        The board processes one line after the other, at the speed of its intake. It is ahead of
        its motors by at most as many blocks as its ring has.
        """
        hz = self._rig.engine.tick_hz
        # Of the motion of the blocks in the ring, in s.
        ends: deque[float] = deque(maxlen=self._planner.flow[self._layout.ROWS] - 1)
        chord_s = 1 / board_intake.rates.chords
        late: dict[int, float] = {}
        now = motion_end = 0.0  # in s: of the board's processing, and of the motion planned so far
        for number, line, kind in zip(range(1, len(self.blocks)), lines, kinds, strict=False):
            now += _cost_s(line, kind, board_intake)
            blocks = self.blocks[number]
            for block in range(blocks):
                now += chord_s if block else 0.0
                if len(ends) == ends.maxlen:
                    now = max(now, ends[0])  # until the ring has space
                if block == 0 and number in self.from_rest:  # not late: nothing moves anyway
                    now = motion_end = max(now, motion_end)
                elif now > motion_end:
                    late[number] = late.get(number, 0.0) + now - motion_end
                    motion_end = now
                motion_end += self.ticks[number] / hz / blocks
                ends.append(motion_end)
        return late

    def _stretch(
        self,
        part: tuple[int, int],
        late: dict[int, float],
        lines: Sequence[bytes],
        kinds: Sequence[str],
        board_intake: Intake,
    ) -> Stretch:
        """Return the stretch between two lines: its speed, the board's, and the kind of line that
        costs most."""
        numbers = range(part[0], part[1] + 1)
        moved_s = sum(self.ticks[number] for number in numbers) / self._rig.engine.tick_hz
        costs: defaultdict[str, float] = defaultdict(float)  # in s, by kind
        for number in numbers:
            kind = kinds[number - 1]
            costs[kind] += _cost_s(lines[number - 1], kind, board_intake)
            if self.blocks[number] > 1:
                costs[_CHORDS] += (self.blocks[number] - 1) / board_intake.rates.chords
        needed_s = sum(costs.values())
        return Stretch(
            first=part[0],
            last=part[1],
            needed=round(len(numbers) / max(moved_s, 1e-6), 1),
            taken=round(len(numbers) / needed_s, 1),
            lost_s=round(sum(late.get(number, 0.0) for number in numbers), 3),
            kind=max(costs, key=lambda kind: costs[kind]),
            feed=int(100 * moved_s / needed_s),
        )


def _cost_s(line: bytes, kind: str, board_intake: Intake) -> float:
    """Return the time in s that a board needs for a line. The link transfers it in the same
    time."""
    link_s = (len(line) + 1) / board_intake.bytes_s if board_intake.bytes_s else 0.0
    return max(link_s, board_intake.rates.line_s(kind))


def _parts(late: dict[int, float]) -> Iterator[tuple[int, int]]:
    """Yield first and last line of each stretch with late lines."""
    first = last = 0  # first 0: no stretch has begun
    for number in late:
        if first and number > last + _APART:
            yield first, last
            first = 0
        first = first or number
        last = number
    if first:
        yield first, last


def _kinds(lines: Sequence[bytes], laser: bool) -> Iterator[str]:
    """Yield for each line how the firmware processes it: kernels process most lines
    (language/line.py). laser: laser mode is on, so that kernels read S, too."""
    motion = b""  # number of the active G word: 0 to 3
    active = set(_AT_FIRST)
    for line in lines:
        text = without_comments(line).upper().replace(b" ", b"").replace(b"\t", b"")
        words = _activate_new(_WORD.findall(text), active)
        words = [word for word in words if b"".join(word) not in _MEANINGS]
        letters = {letter[0] for letter, _ in words}
        g_numbers = [value.lstrip(b"0") or b"0" for letter, value in words if letter == b"G"]
        motion = next((value for value in g_numbers if value in _STRAIGHT + _ARCS), motion)
        moves = letters & _AXES
        has_other_words = letters - _LETTERS or set(g_numbers) - {motion}
        if has_other_words or (moves and motion not in _STRAIGHT):
            yield _IN_PYTHON
        elif b"S"[0] in letters:
            yield (_POWER if moves else _NO_WORDS) if laser else _IN_PYTHON
        else:
            yield _PLAIN if moves else _NO_WORDS


def _activate_new(
    words: "list[tuple[bytes, bytes]]", active: set[bytes]
) -> "list[tuple[bytes, bytes]]":
    """Return the words (letter and value) that are not active yet. A modal word becomes active in
    place of those of its group."""
    new = []
    for letter, value in words:
        word = letter + (value.lstrip(b"0") or b"0")
        if word not in active:
            new.append((letter, value))
        for group in _GROUPS:
            if word in group:
                active -= group
                active.add(word)
    return new
