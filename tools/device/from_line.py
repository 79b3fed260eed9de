"""Start a program at a line in its middle: the lines that prepare for it, with descriptions.

The simulator has run the lines before, so modes, feed, speed, tool and position are known. The
approach is safe: first up to a safe height, then across, tool on, then down at feed rate.

here: the machine's state now. there: the state that the program needs at that line. Positions are
machine positions in mm. Line numbers count from 1.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..grbl.gcode_file import without_comments
from ..run.rehearsal import Forecast
from .machine_snapshot import SYSTEMS, MachineSnapshot, axis_words, number_word, read
from .send import Line

_SPIN_UP_S = 4  # wait for the spindle
_SLOW_MM_MIN = 100.0
_NEAR_MM = 0.001  # no move is needed for less
_MOTION = re.compile(rb"G0*[0123](?![\d.])")
_CYCLE = re.compile(rb"G(?:73|8[1-9])(?!\d)")
_CYCLE_ENDS = re.compile(rb"G(?:0*[0123]|80|38)(?!\d)|M0*(?:2|30)(?!\d)")
_RELATIVE = re.compile(rb"G91(?![\d.])")
_ORIGIN = re.compile(rb"G92(?![\d.])|(?=.*G10(?![\d.])).*L20(?![\d.])")
_STORES = re.compile(rb"G10(?![\d.])|G28\.1|G30\.1")
_GOES_TO = re.compile(rb"G(28|30)(?![\d.])")
_SETTING = re.compile(rb"\$(\d+)=([\d.]+)")
_SAME = 0.0005  # settings are reported with three decimals
_TOOL = re.compile(rb"T\d|M0*6(?!\d)")


class CannotEnter(Exception):
    """A program cannot be started at this line; the text says why."""


@dataclass
class Approach:
    """The way to a line."""

    lines: list[Line]
    words: list[str]  # descriptions of what the lines do
    cautions: list[str]


def approach(
    lines: Sequence[bytes], number: int, forecast: Forecast, here: MachineSnapshot
) -> Approach:
    """Return the way from the machine's position to line `number`. forecast: the simulator's,
    after the lines before. CannotEnter if the program cannot begin there."""
    if forecast.stopped:
        raise CannotEnter(f"the lines before cannot be simulated: {forecast.stopped}")
    before, after = lines[: number - 1], lines[number - 1 :]  # after: from that line on
    there = read(forecast.at_line)
    _check_motion(lines[number - 1], number, there.modes, here.laser())
    _check_cycle(lines, number)
    _check_settings(before, here)
    _check_stored_positions(after, here, there)
    safe_mm = max(forecast.highest_mm(number), here.place[2])
    all_steps = _Steps(here, there, forecast.at_place, safe_mm).all()
    steps = [(text, description) for text, description in all_steps if text]
    to_send = [Line(0, text.encode("ascii"), text) for text, _ in steps]
    words = [description for _, description in steps if description]
    cautions = _cautions(before)
    cautions += _cautions_after(lines, number)
    cautions += [
        f"{name} has to be on at that line: make sure that it is" for name in forecast.outputs_on
    ]
    return Approach(to_send, words, cautions)


def _check_motion(line: bytes, number: int, modes: Sequence[str], laser: bool) -> None:
    """Raise CannotEnter if the line continues an arc of a line before, or a laser's cut in M3: an
    arc's mode cannot be set without an arc, and in M3 a laser burns at standstill as soon as G1 is
    active. modes: active before the line."""
    refused = ("G1", "G2", "G3") if laser and "M3" in modes else ("G2", "G3")
    motion = next((word for word in modes if word in refused), "")
    if motion and not _MOTION.search(_code(line)):
        text = f"line {number} continues {motion} of an earlier line"
        raise CannotEnter(f"{text}: begin with a line that names its motion (G0 to G3)")


def _check_cycle(lines: Sequence[bytes], number: int) -> None:
    """Raise CannotEnter if the line continues a drilling cycle, because the cycle's depth, height
    and retract are in its first line."""
    begun = 0  # number of the line that began the active cycle; 0: there is none
    for line_number, line in enumerate(lines[: number - 1], 1):
        code = _code(line)
        if _CYCLE.search(code):
            begun = begun or line_number
        elif _CYCLE_ENDS.search(code):
            begun = 0
    if begun and not _CYCLE_ENDS.search(_code(lines[number - 1])):
        text = f"line {number} continues the drilling cycle of line {begun}"
        raise CannotEnter(f"{text}: start there, or after its end")


def _check_settings(before: Sequence[bytes], here: MachineSnapshot) -> None:
    """Raise CannotEnter if the machine's settings differ from those that the lines before have
    stored."""
    for number, line in enumerate(before, 1):
        match = _SETTING.fullmatch(_code(line))
        if not match or (now := here.settings.get(int(match[1]))) is None:
            continue
        if abs(float(match[2]) - float(now)) > _SAME:
            raise CannotEnter(
                f"line {number} sets ${int(match[1])}, which is {now} now: set it first"
            )


def _check_stored_positions(
    after: Sequence[bytes], here: MachineSnapshot, there: MachineSnapshot
) -> None:
    """Raise CannotEnter if the lines from there on go to a position (G28, G30) that lines before
    store (G28.1, G30.1): these store where the tool is, so they cannot be repeated here."""
    for line in after:
        for word in _GOES_TO.findall(_code(line)):
            name = f"G{word.decode()}"
            if there.offsets.get(name) != here.offsets.get(name):
                text = f"the lines before store another position for {name} ({name}.1)"
                raise CannotEnter(f"{text}, and a later line moves there: begin before it")


class _Steps:
    """The lines that prepare for a program, each with a description of what it does; "" if there
    is nothing to say or, as a line, nothing to do. place: position at which the program begins.
    safe_mm: height at which it is approached."""

    def __init__(
        self, here: MachineSnapshot, there: MachineSnapshot, place: Sequence[float], safe_mm: float
    ) -> None:
        self._here = here
        self._there = there
        self._place = place
        self._safe_mm = safe_mm
        self._modes = there.modes

    def all(self) -> list[tuple[str, str]]:
        """Return all lines with their descriptions, in order. A spindle is switched on before the
        tool moves across, a laser only at the begin of the program."""
        laser = self._here.laser()
        across = (
            f"G53 G0 {axis_words(self._place[:2])}",
            f"across to {self._xy_words(self._place)}",
        )
        return [
            ("G21 G90 G94 M5", ""),  # mm, absolute, mm/min, tool off
            self._move_up(),
            *([] if laser else self._switch_on()),
            across,
            self._move_down(),
            *self._set_offsets(),
            *(self._switch_on() if laser else []),
            (f"F{self._feed()}", f"feed {self._feed()} mm/min"),
            (self._modes_line(), f"modes {self._modes_line()}"),
            # On a line of its own, because with G1 Grbl would require an F.
            ("G93", "G93, a time in each line") if "G93" in self._modes else ("", ""),
        ]

    def _xy_words(self, place: Sequence[float]) -> str:
        """Return X and Y of a position as words, in the work coordinates of the program."""
        offset = self._there.work_offset()
        work = [machine - shift for machine, shift in zip(place, offset, strict=False)]
        return axis_words(work[:2])

    def _height(self, z_mm: float) -> str:
        """Return a height in machine coordinates as a word in work coordinates."""
        return f"Z{z_mm - self._there.work_offset()[2]:.3f}"

    def _move_up(self) -> tuple[str, str]:
        """Return the line up to the safe height with its description; ("", "") if it is there."""
        if self._safe_mm - self._here.place[2] < _NEAR_MM:
            return "", ""
        description = (
            f"up to {self._height(self._safe_mm)}, the highest the program has been by then"
        )
        return f"G53 G0 Z{self._safe_mm:.3f}", description

    def _move_down(self) -> tuple[str, str]:
        """Return the line down to the program's position, at feed rate, with its description."""
        if self._safe_mm - self._place[2] < _NEAR_MM:
            return "", ""
        description = f"down to {self._height(self._place[2])} at {self._feed()} mm/min"
        return f"G53 G1 Z{self._place[2]:.3f} F{self._feed()}", description

    def _feed(self) -> str:
        """Return the feed in mm/min."""
        return number_word(self._there.feed_mm_min() or _SLOW_MM_MIN)

    def _speed(self) -> str:
        """Return the program's S word."""
        return f"S{number_word(self._there.word('S'))}"

    def _switch_on(self) -> list[tuple[str, str]]:
        """Return lines for spindle or laser, and coolant, as the program has them."""
        steps = []
        spin = next((word for word in self._modes if word in ("M3", "M4")), "")
        if spin:
            on = f"{spin} {self._speed()}"
            if self._here.laser():
                steps.append((f"G0 {on}", f"laser on: {on}"))  # no power until it moves
            else:
                steps.append((on, f"spindle on: {on}, and {_SPIN_UP_S} s for it to speed up"))
                steps.append((f"G4 P{_SPIN_UP_S}", ""))
        steps += [(word, f"coolant on: {word}") for word in self._modes if word in ("M7", "M8")]
        return steps

    def _set_offsets(self) -> list[tuple[str, str]]:
        """Return lines for all offsets that the lines before leave different from the machine's.
        The machine is at _place when they are executed."""
        here, there = self._here, self._there
        steps = []
        for number, name in enumerate(SYSTEMS, 1):
            stored = there.offsets.get(name, [])
            if stored != here.offsets.get(name, [0.0] * len(stored)):
                words = axis_words(stored)
                steps.append((f"G10 L2 P{number} {words}", f"{name} is stored as {words}"))
        if there.tool_length() != here.tool_length():
            length = there.tool_length()
            steps.append((f"G43.1 Z{length:.3f}", f"tool length offset {length:.3f}"))
        if there.offsets.get("G92") != here.offsets.get("G92"):
            # G92 takes the work position that the machine shall have here, in the active system.
            axes = zip(self._place, there.work_offset(), strict=False)
            words = axis_words([machine - shift for machine, shift in axes])
            steps.append((f"{there.system()} G92 {words}", f"G92 {words}"))
        return steps

    def _modes_line(self) -> str:
        """Return a line that sets the program's modes and S."""
        wanted: tuple[str, ...] = ("G17", "G18", "G19", "G20", "G21", "G90", "G91", "G94")
        # With a laser in M3 the program's line names its motion: see _check_motion().
        if not (self._here.laser() and "M3" in self._modes):
            wanted = ("G0", "G1", "G80", *wanted)
        words = [word for word in self._modes if word in (*wanted, *SYSTEMS)]
        return " ".join([*words, self._speed()])


def _cautions_after(lines: Sequence[bytes], number: int) -> list[str]:
    """Return a warning about the first line from there on that stores offsets: it may have been
    executed before."""
    for later_number, line in enumerate(lines[number - 1 :], number):
        if _STORES.search(_code(line)):
            text = f"line {later_number} stores offsets: if it has already been executed"
            return [f"{text}, first restore the offsets that it has replaced"]
    return []


def _cautions(before: Sequence[bytes]) -> list[str]:
    """Return warnings about what only the user can check; each names the last such line before."""
    found = []
    for pattern, text in (
        (_RELATIVE, "moves relatively (G91): the above is right only if the program began here"),
        (
            _ORIGIN,
            "sets the origin where the tool is: right only if the tool is at the same place again",
        ),
        (_TOOL, "names a tool: make sure that it is in the spindle"),
    ):
        numbers = [number for number, line in enumerate(before, 1) if pattern.search(_code(line))]
        if numbers:
            found.append(f"line {numbers[-1]} {text}")
    return found


def _code(line: bytes) -> bytes:
    """Return a line's G-code in capitals, without comments and spaces."""
    return without_comments(line).replace(b" ", b"").upper()
