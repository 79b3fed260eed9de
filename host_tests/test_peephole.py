"""Native code made shorter: it does what it did, instruction by instruction of what shows."""

from collections.abc import Iterator

import pytest
from thumb_model import FAR, Run
from ugrbl.boardfile.files import board_file
from ugrbl.compiling import build, mpy, peephole, thumb

_STEPS = 3000
_RUNS = 15


@pytest.fixture(scope="module")
def functions() -> "list[bytes]":
    """All that a Pico and a laser on one have, as the compiler made them."""
    found: list[bytes] = []

    def seen(code: bytes, _place: int) -> bytes:
        found.append(code)
        return code

    def linked(compiled: "dict[str, bytes]", _texts: object) -> "dict[str, bytes]":
        return {name: mpy.rewritten(module, seen) for name, module in compiled.items()}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "linked", linked)
        for board in ("rpi_pico", "pico_laser"):
            build.for_board(board_file(board))
    return list(dict.fromkeys(found))


def held(code: bytes, made: bytes, seeds: "Iterator[int] | range") -> int:
    """Both show the same. Returns how often they came to their end."""
    ends = 0
    for seed in seeds:
        due = Run(code, seed).go(_STEPS)
        told = Run(made, seed).go(_STEPS)
        for now, before in zip(told, due, strict=False):
            if before[0] == "call" and before[2][1] == FAR:
                now[2][1] = FAR
            assert now == before, seed
        assert len(told) >= len(due)
        ended = bool(due) and due[-1][0] == "ends"
        assert not ended or len(told) == len(due)
        ends += ended
    return ends


def test_shorter_code_does_the_same(functions: "list[bytes]") -> None:
    changed = [code for code in functions if peephole.shorter(code) != code]
    assert len(changed) > len(functions) * 0.8
    ends = sum(held(code, peephole.shorter(code), range(_RUNS)) for code in changed)
    assert ends > len(changed) * _RUNS / 4  # they are not all cut off in a loop


def test_a_third_is_saved(functions: "list[bytes]") -> None:
    made = sum(len(peephole.shorter(code)) for code in functions)
    assert made < sum(map(len, functions)) * 2 / 3


def test_the_model_sees_what_is_wrong(functions: "list[bytes]") -> None:
    """One branch of a function the other way round."""
    code = max(functions, key=len)
    ops = thumb.read(code)
    branches = [op for op in ops if op.branches]
    branches[len(branches) // 8].code ^= 0x100
    with pytest.raises(AssertionError):
        held(code, thumb.write(ops), range(_RUNS))
