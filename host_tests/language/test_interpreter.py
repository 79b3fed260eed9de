"""The interpreter without a machine: what each line calls, in which order; and its tables."""

from types import SimpleNamespace
from typing import Any

import pytest
from base import errors
from base.errors import GrblError
from base.settings import Settings
from base.state import State
from control.coords import Coords
from control.modes import Modes
from fakes import FakeCanon, FakeStore, FakeVoice
from language import block_layout as b
from language.block import GROUP, ROW, SETTING, Block
from language.block import dictionary as words
from language.block_layout import MOVE
from language.interpreter import Interpreter


class RecordingInterpreter:
    """An interpreter whose machine only records the calls it gets, as texts, in canon.asked."""

    def __init__(self) -> None:
        self.canon, self.voice, store = FakeCanon(), FakeVoice(), FakeStore()
        settings = Settings(store, axes=3, defaults={})
        settings.load()
        self.modes, self.coords = Modes(3), Coords(store, axes=3, length_axis=2)
        block, state = Block(b"XYZ", has_mist=True, has_override_control=True), State()
        state.hooks.probe, state.hooks.write_offsets = self._probe, self.coords.write
        machine: Any = SimpleNamespace(
            modes=self.modes,
            state=state,
            settings=settings,
            coords=self.coords,
            canon=self.canon,
            spindle=SimpleNamespace(laser=False),
            report=self.voice,
        )
        self.interpreter = Interpreter(machine, block, line_numbers=False)
        self.interpreter.watch(MOVE)  # without it the kernels would plan lines unseen

    def _probe(self, *_: object) -> bool:
        self.canon.asked.append("probe")
        return True

    def calls_for(self, *lines: str) -> "list[str]":
        """Run lines without spaces; return the calls of the last one."""
        for line in lines:
            self.canon.asked.clear()
            text = bytearray(line.encode() + b"\0")
            execute_line = (
                self.interpreter.jog if line.startswith("$J=") else self.interpreter.execute
            )
            execute_line(text, len(line))
        return self.canon.asked


@pytest.mark.parametrize(
    ("lines", "calls"),
    [
        (("G1X10F600",), ["line F600 10 0 0"]),
        (("G91G1X10F600", "X10"), ["line F600 20 0 0"]),
        (("G20G0Z1",), ["rapid 0 0 25.4"]),
        (("G2X2Y0I1J0F60",), ["arc F60 0 0 0 to 2 0 0"]),
        (("F60X1G1S100M3M8",), ["spin 16 100", "cool 1", "line F60 1 0 0"]),
        (("G4P0.5",), ["dwell 0.5"]),
        (("M56P0",), ["parking False"]),
        (("G0X1Y2", "G28.1"), ["synchronise"]),
        (("G0X1Y2", "G28.1", "G0X5", "G28Y0"), ["rapid 5 0 0", "rapid 5 2 0"]),
        (("G10L2P1X1", "G0X1"), ["rapid 2 0 0"]),
        (("G38.2X1F10",), ["probe"]),
        (("M0",), ["synchronise", "pause"]),
        (("M30",), ["synchronise", "end", "synchronise"]),
        (("$J=X1F10",), ["jog F10 1 0 0"]),
    ],
)
def test_a_line_makes_these_calls_of_the_machine(
    lines: "tuple[str, ...]", calls: "list[str]"
) -> None:
    """calls: those for the last line; feed in mm/min, positions in mm, 16 is M3."""
    assert RecordingInterpreter().calls_for(*lines) == calls


def test_the_end_of_a_program_is_reported() -> None:
    interpreter = RecordingInterpreter()
    interpreter.calls_for("M2")
    assert interpreter.voice.asked == [f"message {errors.MSG_PROGRAM_END}"]


@pytest.mark.parametrize("line", ["G1X1", "G2X1F10", "G1X1F10M3S1M99", "G38.2F10"])
def test_a_refused_line_makes_no_calls(line: str) -> None:
    """rates[0] is the feed: F is not taken over either."""
    interpreter = RecordingInterpreter()
    with pytest.raises(GrblError):
        interpreter.calls_for(line)
    assert interpreter.canon.asked == []
    assert list(interpreter.modes.position) == [0, 0, 0] and interpreter.modes.rates[0] == 0


def test_a_jog_beyond_the_travel_is_refused() -> None:
    interpreter = RecordingInterpreter()
    interpreter.canon.too_far = 10  # mm
    assert interpreter.calls_for("$J=X10F10") == ["jog F10 10 0 0"]
    with pytest.raises(GrblError) as refused:
        interpreter.calls_for("$J=X11F10")
    assert refused.value.code == errors.TRAVEL_EXCEEDED and interpreter.canon.asked == []


@pytest.mark.parametrize(
    ("group", "known"),
    [
        (b.GROUP_1, {b.SEEK, b.LINEAR, b.CW_ARC, b.CCW_ARC, 38, b.NO_MOTION}),
        (
            b.GROUP_0,
            {b.DWELL, b.SET_COORDS, b.GO_G28, b.GO_G30, b.ABSOLUTE_OVERRIDE, b.SET_G92},
        ),
    ],
    ids=["motions", "commands"],
)
def test_every_word_in_the_dictionary_is_executed(group: int, known: "set[int]") -> None:
    """Interpreter.run_move() treats an unknown motion as a probe (38), and _non_modal() ignores an
    unknown command: a new word of the dictionary must be added there, and here."""
    rows = [words[i : i + ROW] for i in range(ROW, len(words), ROW)]
    assert {row[SETTING] for row in rows if row[GROUP] | row[GROUP + 1] << 8 == group} == known
