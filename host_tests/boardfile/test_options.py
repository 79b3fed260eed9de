"""Test the table of board options: code reads only options of the table, with its defaults."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest
from boot import parts
from esp_bench import i2s
from extras import power_fail
from extras.jobs import job_commands
from extras.motors import tmc2209
from extras.tools import punch
from pio.engine import PioEngine
from ports import pin_check
from typer.testing import CliRunner
from ugrbl import paths
from ugrbl.boardfile import chips, engines
from ugrbl.boardfile.chips import CHIPS
from ugrbl.boardfile.files import boards, load_board
from ugrbl.boardfile.options import (
    BY_NAME,
    COUNT,
    INVERTIBLE,
    NAMED_PINS,
    NEEDED,
    OPTIONS,
    PIN,
    PIN_OR_PINS,
    PINS,
    Option,
)
from ugrbl.cli.app import app
from ugrbl.device.deploy import About
from ugrbl.device.selftest import session

_NOTHING = (None, "", (), 0)


class Read(NamedTuple):
    """An option that code reads; default is None where the code gives none."""

    name: str
    default: "ast.expr | None"


def is_board(node: ast.expr) -> bool:
    return ast.unparse(node).endswith("board")


def options_read_by(tree: ast.AST) -> Iterator[Read]:
    """Yield the options that a module reads.

    The forms are option("X", 1), getattr(board, "X", 1), hasattr(…), board.X, board.__dict__["X"],
    and the tables _ORDER (of extras) and PINS.
    """
    for node in ast.walk(tree):
        match node:
            case ast.Call(ast.Name("option"), [ast.Constant(str(name)), *rest]):
                yield Read(name, rest[0] if rest else None)
            case ast.Call(ast.Name("getattr" | "hasattr"), [board, ast.Constant(name), *rest]):
                if is_board(board):
                    yield Read(str(name), rest[0] if rest else None)
            case ast.Assign([ast.Name("_ORDER")], ast.Tuple() as rows):
                yield from (Read(row[0], None) for row in ast.literal_eval(rows))
            case ast.Call(
                ast.Attribute(ast.Attribute(board, "__dict__"), "get"),
                [ast.Constant(name), *rest],
            ) if is_board(board):
                yield Read(str(name), rest[0] if rest else None)
            case ast.Subscript(ast.Attribute(board, "__dict__"), ast.Constant(name)):
                if is_board(board):
                    yield Read(str(name), None)
            case ast.Attribute(board, name) if name.isupper() and is_board(board):
                yield Read(name, None)
            case ast.Assign([ast.Name("PINS")], ast.Tuple() as names):
                yield from (Read(name, None) for name in ast.literal_eval(names))


def default_value(node: ast.expr, tree: ast.Module) -> Any:
    """Return the value of a default; it may be a constant of its module (tree)."""
    for statement in tree.body:
        match node, statement:  # X = 5, or X = const(5)
            case ast.Name(name), ast.Assign([ast.Name(defined)], assigned) if name == defined:
                number = assigned.args[0] if isinstance(assigned, ast.Call) else assigned
                return ast.literal_eval(number)
    return ast.literal_eval(node)


def options_read_in(folder: Path) -> "Iterator[tuple[str, Read, ast.Module]]":
    """Yield (file name, option that it reads, syntax tree) for all modules in a folder."""
    for file in sorted(folder.rglob("*.py")):
        tree = ast.parse(file.read_text("utf-8"))
        yield from ((file.name, read, tree) for read in options_read_by(tree))


@cache
def all_options_read() -> "list[tuple[str, Read, ast.Module]]":
    """Return the same for firmware, simulator and self-test."""
    folders = (paths.FIRMWARE, paths.TOOLS / "sim", paths.TOOLS / "device/selftest/on_board")
    return [row for folder in folders for row in options_read_in(folder)]


def test_all_forms_of_reading_an_option_are_found() -> None:
    text = (
        'option("A", 1)\ngetattr(board, "B", 2)\nrig.board.C\nboard.__dict__["D"]\n'
        'hasattr(self.board, "E")\nboard.__dict__.get("F", 6)\nPINS = ("G",)\n'
        '_ORDER = (("H", "h"), ("I", "i"))\n'
    )
    found = {read.name: read.default for read in options_read_by(ast.parse(text))}
    assert set(found) == set("ABCDEFGHI")
    # only these have a default
    assert {name for name, default in found.items() if default} == set("ABF")


def test_options_read_by_code_are_the_rows_of_the_table() -> None:
    read = {read.name for _, read, _ in all_options_read()}
    assert set(BY_NAME) - read == {"CHIP"}  # only tools read it
    assert read - set(BY_NAME) == set()
    assert len(BY_NAME) == len(OPTIONS)


def test_defaults_in_code_match_the_table() -> None:
    """The code's default of a NEEDED option is empty, because board_check requires the option."""
    for file, read, tree in all_options_read():
        if not read.default:
            continue
        in_code, in_table = default_value(read.default, tree), BY_NAME[read.name].default
        if in_table is NEEDED or in_code in _NOTHING:
            assert in_code in _NOTHING and (in_table is NEEDED or not in_table), (file, read.name)
        else:
            assert (type(in_code), in_code) == (type(in_table), in_table), (file, read.name)


@pytest.mark.parametrize("option", OPTIONS, ids=lambda option: option.name)
def test_row_is_complete(option: Option) -> None:
    assert option.meaning.endswith((".", "?"))
    if option.default not in (NEEDED, None):
        assert option.problem(option.default) == ""
    # only numbers have limits
    assert option.kind is COUNT or (option.low, option.high) == (0, None)


def test_options_checked_as_pins_are_pins_in_the_table() -> None:
    """checked: options that engines, the pin check and extras treat as pins."""
    kinds = (PIN, PINS, PIN_OR_PINS, NAMED_PINS)
    pins = {option.name for option in OPTIONS if option.kind in kinds}
    pins -= {"NO_PULL_UP"}  # repeats pins of other options
    checked = {name for engine in engines.engines().values() for name in engine.pins}
    checked |= {*pin_check._NAMES.split(), *job_commands.PINS, *punch.PINS, *tmc2209.PINS}
    checked |= {*power_fail.PINS}
    assert checked == pins
    assert set(INVERTIBLE) < pins


# Engines, links and chips


def test_engine_is_complete() -> None:
    for name, engine in engines.engines().items():
        assert {*engine.needed, *engine.pins} <= set(BY_NAME), name
        assert engine.most_hz > 0 and engine.oldest


def test_engine_rate_matches_the_rate_at_its_shortest_pulse() -> None:
    """The table engines() states rates without an engine; here they are those of the engine
    classes."""
    engine_table, no_engine = engines.engines(), cast("Any", None)
    assert engine_table["pio"].most_hz == PioEngine.max_step_hz(no_engine, 3)  # 3 us
    # pulses of 16 us: 2 frames
    engine: Any = SimpleNamespace(_rate_hz=125_000, _frames_of=lambda us: 2)
    assert engine_table["i2s"].most_hz == i2s.I2sEngine.max_step_hz(engine, 16)
    rates = {
        board.MAX_STEP_RATE_HZ for board in map(load_board, boards()) if board.ENGINE == "rmt"
    }
    assert {engine_table["rmt"].most_hz} == rates, (
        "its trains have gaps beyond: see esp32_devkit.py"
    )


def test_chip_names_an_engine_that_runs_on_it_and_an_existing_link() -> None:
    known = engines.engines()
    for name, chip in CHIPS.items():
        assert known[chip.engine].runs_on(chip.processor), name
        assert chip.link in engines.links()
        assert set(chip.inputs_only) | set(chip.odd) <= chip.pins


def test_every_engine_has_a_chip_and_every_arch_a_chip() -> None:
    for name, engine in engines.engines().items():
        assert any(engine.runs_on(chip.processor) for chip in CHIPS.values()), name
    for arch in chips.ARCHS:
        assert {chip.processor for chip in chips.on_their_own(arch)} == set(chips.processors(arch))


def test_maker_has_the_name_of_its_engine_or_link() -> None:
    """A build leaves out the imports of other engines and links: see compiling/build.py."""
    engine_makers = {name: row[0] for name, row in parts._ENGINES.items()}
    assert not engine_makers.keys() & parts._LINKS.keys()
    for name, maker in {**engine_makers, **parts._LINKS}.items():
        assert maker.__name__ == name


def test_self_test_knows_every_processor() -> None:
    for chip in CHIPS.values():
        about = About(0, "1.28.0", f"Some module with {chip.processor}")
        assert session._chip(about)


def test_new_board_accepts_every_chip() -> None:
    shown = CliRunner().invoke(app, ["new-board", "--help"], env={"COLUMNS": "200"}).output
    for name in CHIPS:
        assert name in shown
    wrong = CliRunner().invoke(app, ["new-board", "x", "--chip", "potato", "--no-ask"])
    assert wrong.exit_code == 2 and "potato is not one of pico" in wrong.output
