"""The programs that the board is given: files of on_board/, and what they are told."""

import ast
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_HERE = Path(__file__).parent / "on_board"
CHECKS = ("programs", "watch", "drivers", "drive", "motion", "limits", "rest")
HANG = ("programs", "watch", "drivers", "hang")


@dataclass(frozen=True)
class Chip:
    """Addresses that differ. io_bank: registers of the pins; timer: of microseconds."""

    io_bank: int
    timer: int


RP2040 = Chip(0x40014000, 0x40054028)
RP2350 = Chip(0x40028000, 0x400B0028)


@dataclass(frozen=True)
class Amounts:
    """How much is tried. samples: memory words; edges: of a pin that are told, at the most."""

    run_ms: int = 1000
    seen: tuple[int, int] = (1000, 700)
    samples: int = 16_384
    edges: int = 64
    windows: int = 12
    stops: int = 2000
    starts: int = 1000
    limits: int = 40
    saves: int = 20
    pwm_settles_ms: int = 5


QUICK = Amounts(20, (20, 10), 8192, 64, 2, 24, 24, 3, 8, 1)


def checks(chip: Chip, amounts: Amounts, pwm: bool, seed: int) -> str:
    """All checks but the last. pwm: the spindle's output may be used."""
    return _text(CHECKS, {**asdict(chip), **asdict(amounts), "pwm": pwm, "seed": seed})


def hang(chip: Chip, pwm: bool) -> str:
    """The firmware, moving, and then the hang."""
    program = ["$X\n", *(["M3S500\n"] if pwm else []), "G91G1X50F500\n"]
    return _text(HANG, {**asdict(chip), "edges": 1, "pwm": pwm, "program": program})


def _text(parts: tuple[str, ...], told: dict[str, Any]) -> str:
    return "\n".join([f"CONFIG = {told!r}", *(_part(name) for name in parts)])


def _part(name: str) -> str:
    """A file without what only people, and checkers on the computer, read."""
    tree = ast.parse((_HERE / f"{name}.py").read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [line for line in node.body if not _is_for_us(line)] or [ast.Pass()]
    return ast.unparse(tree)


def _is_for_us(line: ast.stmt) -> bool:
    if isinstance(line, ast.ImportFrom):
        return line.level > 0
    return (
        isinstance(line, ast.Expr)
        and isinstance(line.value, ast.Constant)
        and isinstance(line.value.value, str)
    )
