"""The desktop MicroPython: it runs, finds our modules, and has viper, with 64-bit words."""

import subprocess

import pytest
from micropython_runner import needs_micropython, placed_firmware, run_micropython
from ugrbl.compiling import compilers

pytestmark = needs_micropython


_VIPER = """
import micropython
from array import array

@micropython.viper
def load(p: ptr32, i: int) -> int:
    return p[i]

print(load(array("i", [5, -1]), 0), load(array("i", [5, -1]), 1))
"""


def test_viper_loads_words_zero_extended():
    assert run_micropython(_VIPER).split() == ["5", str(2**32 - 1)]


def test_a_script_finds_modules_and_arguments(tmp_path):
    (tmp_path / "answers.py").write_text("ANSWER = 42")
    script = tmp_path / "script.py"
    script.write_text("import sys, asyncio, answers\nprint(answers.ANSWER, sys.argv[1:])")
    assert run_micropython(script, "a", 1, paths=[tmp_path]) == "42 ['a', '1']\n"


def test_source_text_also_takes_arguments():
    assert run_micropython("import sys\nprint(sys.argv[-1])", "last") == "last\n"


def test_a_failing_script_shows_its_traceback():
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        run_micropython("1 // 0")


def test_an_endless_script_is_stopped():
    with pytest.raises(subprocess.TimeoutExpired):
        run_micropython("while True: pass", timeout=0.5)


def test_a_locked_heap_catches_allocation():
    """Tests of memory rely on it: with the heap locked, a new list raises MemoryError."""
    out = run_micropython(
        """
import micropython
micropython.heap_lock()
try:
    x = [1, 2]
    result = "allocated"
except MemoryError:
    result = "refused"
micropython.heap_unlock()
print(result)
"""
    )
    assert out == "refused\n"


@pytest.mark.thorough
@pytest.mark.parametrize("arch", ["armv6m", "armv7emsp", "xtensawin", "rv32imc"])
def test_the_firmware_compiles_for_every_chip(arch):
    for path in placed_firmware().rglob("*.py"):
        assert compilers.compiled(path.stem, path.read_text("utf-8"), arch)
