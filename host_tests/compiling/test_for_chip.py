"""Test that code for the RP2350 only is left out of an RP2040's firmware, and of no other."""

from typing import Any

import pytest
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.compiling.build import for_chip

_LAYOUT = "pio.state_layout"


@pytest.mark.parametrize(
    ("arch", "is_on"),
    [("armv6m", False), ("armv7emsp", True), ("xtensawin", False), ("x64", False)],
)
def test_constant_says_whether_the_chip_may_be_an_rp2350(arch: str, is_on: bool) -> None:
    """RP2350 is 1 in the sources; for_chip() sets it for the chips of an architecture (armv7emsp:
    RP2350), and changes nothing else."""
    texts = build.texts()
    for_arch = for_chip(texts, arch)
    assert ("\nRP2350 = const(1)\n" in for_arch[_LAYOUT]) is is_on
    assert ("\nRP2350 = const(0)\n" in for_arch[_LAYOUT]) is not is_on
    assert {name for name in texts if for_arch[name] != texts[name]} <= {_LAYOUT}


def test_sources_without_the_constant_are_refused() -> None:
    with pytest.raises(ValueError, match="lacks the line RP2350"):
        for_chip({_LAYOUT: "RP2350 = const(2)\n"}, "armv6m")


@pytest.mark.thorough  # compiles all, twice
@pytest.mark.parametrize(("name", "contains"), [("rpi_pico", False), ("rpi_pico2", True)])
def test_board_contains_rp2350_code_only_on_an_rp2350(name: str, contains: bool) -> None:
    """The text looked for belongs to the third PIO, and to the checks of 48 pins."""
    board: Any = load_board(name)
    engine_file = build.compile_all(board.MPY_ARCH, board).files["pio/engine.mpy"]
    assert (b"only pins 0 to 31 make pulses" in engine_file) is contains
