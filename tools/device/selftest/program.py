"""The programs for the board: files of on_board/ with their parameters."""

import ast
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_HERE = Path(__file__).parent / "on_board"
_ALL = ("say",)
_WATCHED = (*_ALL, "programs", "watch", "drivers")
CHECKS = (*_WATCHED, "rows", "drive", "runs", "motion", "limits", "rest")
HANG = (*_WATCHED, "eyes", "hang")
ESP_CHECKS = (*_ALL, "pcnt", "rows", "drivers", "drive_esp", "runs", "motion_esp", "rest_esp")
ESP_HANG = (*_ALL, "pcnt", "drivers", "eyes_esp", "hang")


@dataclass(frozen=True)
class Chip:
    """Addresses by chip. io_bank: the pins' registers. timer: the register of microseconds."""

    io_bank: int
    timer: int


@dataclass(frozen=True)
class Esp:
    """Addresses by chip. gpio: the pins' registers. out_sel: offset of the output selection.
    units: number of pulse counters."""

    gpio: int
    out_sel: int
    units: int


AnyChip = Chip | Esp
RP2040 = Chip(0x40014000, 0x40054028)
RP2350 = Chip(0x40028000, 0x400B0028)
ESP32 = Esp(0x3FF44000, 0x530, 8)
ESP32_S3 = Esp(0x60004000, 0x554, 4)


@dataclass(frozen=True)
class Amounts:
    """How much is tried. samples: words of memory. edges: the most that are reported per pin."""

    run_ms: int = 1000
    seen: tuple[int, int] = (1000, 700)
    samples: int = 12_288
    edges: int = 64
    windows: int = 12
    stops: int = 2000
    starts: int = 1000
    limits: int = 40
    saves: int = 20
    pwm_settles_ms: int = 5


QUICK = Amounts(
    run_ms=20,
    seen=(20, 10),
    samples=8192,
    edges=64,
    windows=2,
    stops=24,
    starts=24,
    limits=3,
    saves=8,
    pwm_settles_ms=1,
)


# For an ESP32, whose engine is slower: a stop takes 60 ms.
ESP_FULL = Amounts(stops=300, starts=300)
ESP_QUICK = Amounts(run_ms=200, seen=(20, 10), stops=20, starts=20, limits=3)


def amounts(chip: AnyChip, quick: bool) -> Amounts:
    """Return the amounts for a full or a quick test."""
    if isinstance(chip, Esp):
        return ESP_QUICK if quick else ESP_FULL
    return QUICK if quick else Amounts()


def checks(chip: AnyChip, amounts: Amounts, pwm: bool, seed: int) -> str:
    """Return the program of all checks except the hang. pwm: the spindle's output may be used."""
    parts = ESP_CHECKS if isinstance(chip, Esp) else CHECKS
    return _text(parts, {**asdict(chip), **asdict(amounts), "pwm": pwm, "seed": seed})


def hang(chip: AnyChip, pwm: bool) -> str:
    """Return the program that runs the firmware, moves, and then hangs."""
    program = ["$X\n", *(["M3S500\n"] if pwm else []), "G91G1X50F500\n"]
    parts = ESP_HANG if isinstance(chip, Esp) else HANG
    return _text(parts, {**asdict(chip), "edges": 1, "pwm": pwm, "program": program})


def _text(parts: tuple[str, ...], config: dict[str, Any]) -> str:
    """Return one program of these files, with the parameters as CONFIG."""
    return "\n".join([f"CONFIG = {config!r}", *(_part(name) for name in parts)])


def _part(name: str) -> str:
    """Return a file without docstrings, comments and the imports that only checkers need: all
    files of a program are sent as one text, so each finds the names of the others."""
    tree = ast.parse((_HERE / f"{name}.py").read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            statements = [part for part in node.body if not _is_for_checkers(part)]
            node.body = statements or [ast.Pass()]
    return ast.unparse(tree)


def _is_for_checkers(statement: ast.stmt) -> bool:
    """Return whether a statement is a docstring, or an import of another file of on_board/."""
    if isinstance(statement, ast.ImportFrom):
        return statement.level > 0  # from .rows import …
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )
