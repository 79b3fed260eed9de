"""State that a machine reports, and lines that put a simulated machine into the same state.

A program is thus simulated with the settings, offsets, modes and position of the real machine, so
that soft limits and times agree.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from ..grbl.settings_file import AXES
from .connection import Connection

_MM_PER_INCH = 25.4
# If reports have only WPos, every tenth has WCO.
_PLACE_S = 3.0
# Settings that limit where a program may go, or determine its time. Those of homing and inputs are
# left out.
_SETTINGS = (11, 12, 30, 31, 32, *range(100, 106), *range(110, 116), *range(120, 126))
_TRAVEL = range(130, 136)
_HOMING = 22  # numbers of settings
_SOFT_LIMITS = 20
_INCHES = 13
_LASER = 32
_STEPS_PER_MM = 100
_Z = 2  # index of the axis
_SETTING = re.compile(r"\$(\d+)=([\d.]+)")
_OFFSET = re.compile(r"\[(G5[4-9]|G28|G30|G92|TLO):([-\d.,]+)\]")
_MODES = re.compile(r"\[(?:GC:)?(G\d[^\]:]*)\]")
_KEPT_MODES = re.compile(r"G(?:[01]|1[789]|2[01]|5[4-9]|9[0134])|M[3459]|S[\d.]+")
SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59")


@dataclass
class MachineSnapshot:
    """An idle machine. Lengths are in mm; positions are machine positions."""

    settings: dict[int, str] = field(default_factory=dict)
    offsets: dict[str, list[float]] = field(default_factory=dict)  # G54 … G59, G28, G30, G92, TLO
    modes: list[str] = field(default_factory=list)  # words of $G
    place: list[float] = field(default_factory=list)

    def unit_mm(self) -> float:
        """Return the millimetres per unit of the machine's reports ($13)."""
        return _MM_PER_INCH if float(self.settings.get(_INCHES, "0")) else 1.0

    def laser(self) -> bool:
        """Return whether the tool is a laser ($32)."""
        return float(self.settings.get(_LASER, "0")) != 0

    def axes(self) -> int:
        """Return the number of axes."""
        return sum(_STEPS_PER_MM + axis in self.settings for axis in range(len(AXES)))

    def work_offset(self) -> list[float]:
        """Return the work offset: machine position minus work position."""
        total = [0.0] * self._count()
        for name in (self.system(), "G92"):
            total = [mm + more for mm, more in zip(total, self._offset(name), strict=True)]
        total[_Z] += self.tool_length()
        return total

    def tool_length(self) -> float:
        """Return the tool length offset (G43.1)."""
        return self.offsets.get("TLO", [0.0])[0]

    def commands(self) -> list[str]:
        """Return the lines that bring a simulator with factory settings, at position 0, into this
        state. A line that it refuses can be skipped."""
        wanted = (*_SETTINGS, *_TRAVEL, _HOMING)
        lines = [f"${n}={self.settings[n]}" for n in wanted if n in self.settings]
        for name, store in (("G28", "G28.1"), ("G30", "G30.1")):
            if any(self._offset(name)):  # G28.1 stores where the machine is
                lines += [f"G53 G0 {axis_words(self._offset(name))}", store]
        if self.place:
            lines.append(f"G53 G0 {axis_words(self.place)}")
        for index, name in enumerate(SYSTEMS, 1):
            if any(self._offset(name)):
                lines.append(f"G10 L2 P{index} {axis_words(self._offset(name))}")
        lines += self._modal()
        # Soft limits last, because the moves above may be outside.
        if float(self.settings.get(_SOFT_LIMITS, "0")):
            lines.append(f"${_SOFT_LIMITS}=1")
        return lines

    def _modal(self) -> list[str]:
        """Return lines that set work coordinates and modes, with the machine at its position."""
        lines = [self.system()]
        if self.tool_length():
            lines.append(f"G43.1 Z{self.tool_length():.3f}")
        if any(self._offset("G92")) and self.place:
            # G92 takes the work position that the machine shall have where it is.
            axes = zip(self.place, self.work_offset(), strict=False)
            lines.append(f"G92 {axis_words([machine - shift for machine, shift in axes])}")
        if self.feed_mm_min():
            lines.append(f"F{number_word(self.feed_mm_min())}")
        words = [word for word in self.modes if _KEPT_MODES.fullmatch(word)]
        return [*lines, " ".join(words)] if words else lines

    def feed_mm_min(self) -> float:
        """Return the feed rate in mm/min; 0 if there is none, or if each line has its own
        (G93)."""
        feed = 0.0 if "G93" in self.modes else self.word("F")
        return round(feed * self.unit_mm(), 1)

    def word(self, letter: str) -> float:
        """Return the number of a word of $G."""
        return next((float(word[1:]) for word in self.modes if word[0] == letter), 0.0)

    def system(self) -> str:
        """Return the active work coordinate system."""
        return next((word for word in self.modes if word in SYSTEMS), SYSTEMS[0])

    def _offset(self, name: str) -> list[float]:
        """Return an offset of $#, a number per axis; 0 where the machine reports none."""
        return (self.offsets.get(name, []) + [0.0] * len(AXES))[: self._count()]

    def _count(self) -> int:
        """Return the number of axes, at least X, Y and Z."""
        return max(self.axes(), 3)


def read_machine(connection: Connection) -> MachineSnapshot:
    """Read the state of an idle machine. Values it does not report stay as in a new simulator."""
    replies = [reply for line in ("$$", "$#", "$G") for reply in connection.ask(line)]
    connection.wait_for(lambda _line: bool(connection.place()), _PLACE_S)
    snapshot = read(replies)
    snapshot.place = [number * snapshot.unit_mm() for number in connection.place()]
    return snapshot


def read(replies: Iterable[str]) -> MachineSnapshot:
    """Parse replies to $$, $# and $G; lengths are converted to mm."""
    snapshot = MachineSnapshot()
    for reply in replies:
        if match := _SETTING.match(reply):
            snapshot.settings[int(match[1])] = match[2]
        elif match := _OFFSET.fullmatch(reply):
            snapshot.offsets[match[1]] = [float(number) for number in match[2].split(",")]
        elif match := _MODES.fullmatch(reply):
            snapshot.modes = match[1].split()
    for values in snapshot.offsets.values():
        values[:] = [value * snapshot.unit_mm() for value in values]
    return snapshot


def number_word(number: float) -> str:
    """Return a number without exponent, because Grbl does not read exponents."""
    return f"{number:.4f}".rstrip("0").rstrip(".")


def axis_words(place: Sequence[float]) -> str:
    """Return the words of a position: `X1.000 Y2.000 Z3.000`."""
    return " ".join(f"{letter}{mm:.3f}" for letter, mm in zip(AXES, place, strict=False))
