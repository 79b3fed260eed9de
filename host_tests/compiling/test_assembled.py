"""The board gets the lists of its PIO programs, and no assembler's work."""

from array import array

import pytest
from ugrbl.compiling import build
from ugrbl.compiling.assembled import assembled

_PROGRAMS = {"pio.programs": ("stepper", "clock"), "pio.beam_program": ("beam",)}


@pytest.mark.parametrize("name", _PROGRAMS)
def test_a_program_is_the_list_that_an_assembler_makes_in_the_same_line(name: str) -> None:
    written = build.texts()[name]
    made = assembled({name: written})[name]
    assert made.count("\n") == written.count("\n") and "rp2" not in made.partition('"""\n')[2]
    listed: dict[str, object] = {}
    exec(made, listed)
    there = __import__(name, None, None, ("",))
    for program in _PROGRAMS[name]:
        assert listed[program] == getattr(there, program)
        (line,) = (
            n for n, text in enumerate(made.splitlines()) if text.startswith(f"{program} =")
        )
        assert written.splitlines()[line].startswith("@asm_pio")
    for constant in ("NEXT", "MADE", "CLOCK_PULL"):
        assert listed.get(constant) == getattr(there, constant, None)


def test_words_have_the_lower_byte_first() -> None:
    text = (
        "from rp2 import PIO, asm_pio\n@asm_pio()\ndef only():\n    pull(block)\n    set(x, 1)\n"
    )
    made = assembled({"m": text})["m"]
    found: dict[str, list[object]] = {}
    exec(made, found)
    assert found["only"] == [
        array("H", [0x80A0, 0xE021]),
        -1,
        -1,
        -1,
        1 << 12,
        0,
        None,
        None,
        None,
    ]
    assert r"b'\xa0\x80!\xe0'" in made


def test_other_modules_are_left_as_they_are() -> None:
    text = "import rp2\n\ndef f():\n    return rp2.PIO(1)\n"
    assert assembled({"m": text}) == {"m": text}


def test_no_board_has_an_assembler_in_its_modules() -> None:
    assert not [
        name for name, text in build.prepared_firmware().texts.items() if "asm_pio" in text
    ]
