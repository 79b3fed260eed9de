"""Short names in the firmware that is compiled: the same meaning, and fewer names in memory."""

import ast
import subprocess
import sys
from pathlib import Path

import mpy_file
import pytest
from ugrbl import paths
from ugrbl.compiling import build
from ugrbl.compiling.inline import inline
from ugrbl.compiling.prune import prune
from ugrbl.compiling.scan import _SELDOM, private_methods
from ugrbl.compiling.short_names import SHORT
from ugrbl.compiling.shorten import shorten

# Passes of the build, and what they make: the first ring takes a few.
pytestmark = pytest.mark.thorough

PARTS = '''from micropython import const

LIMIT_MM = 12.5
TYPE_CHECKING = const(False)
_LONG = const(7)
_TABLE = (  # attribute-names: column 1
    (0, "pulse_us", 0, 10, "microseconds"),
    (1, "idle_ms", 0, 25, "milliseconds"),
)
_factors = [1, 2]


class Base:
    inherited = 5

    def __init__(self, factor, offset=_LONG):
        self._factor = factor
        self._offset = offset
        self.settings_file = "file"


class Part(Base):
    pulse_us: int

    def __init__(self, factor):
        super().__init__(factor)
        self._own = [_factors, TYPE_CHECKING]
        for row in _TABLE:
            setattr(self, row[1], row[3])

    def total(self, amount, é=1):
        """Not amount: a comment."""
        more = [amount * each for each in self._own[0]]
        return sum(more) + é + (lambda deep: deep + amount + self._offset)(self.pulse_us)

    def append(self, amount):
        self._own.append(amount)
        return getattr(self, "idle_ms"), self.inherited, self._factor


class Fault(Exception):
    def __init__(self, number):
        self.number = number
'''

USER = """import parts
from parts import LIMIT_MM, Fault, Part


def go(machine, keyword=3):
    part = machine.reader
    part.pulse_us += keyword
    return part.total(4), part.append(1), LIMIT_MM, parts.LIMIT_MM, part.settings_file


class Machine:
    def __init__(self):
        self.reader = Part(2)


try:
    raise Fault(9)
except Fault as fault:
    RESULT = go(Machine(), keyword=8), fault.number
"""

MAKER = 'MAKER = "_make_"  # keep-prefix: methods are looked for by it\n'
IN = "class A:\n    def f(self):\n        "

SOURCES = {"parts": PARTS, "user": USER}


def outcome(sources: "dict[str, str]", folder: Path) -> str:
    """What a program of two modules comes to, in an interpreter of its own."""
    folder.mkdir()
    for name, text in sources.items():
        (folder / f"{name}.py").write_text(text)
    code = f"import sys; sys.path[:0] = [{str(folder)!r}, {str(paths.STANDINS)!r}]; import user"
    command = [sys.executable, "-c", code + "; print(user.RESULT)"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def names(text: str) -> set[str]:
    """Every name of a source."""
    return {
        value
        for node in ast.walk(ast.parse(text))
        for _, value in ast.iter_fields(node)
        if isinstance(value, str)
    }


def test_a_program_means_the_same(tmp_path: Path) -> None:
    before = outcome(SOURCES, tmp_path / "before")
    assert before == "((42, (25, 5, 2), 12.5, 12.5, 'file'), 9)\n"
    assert outcome(shorten(SOURCES).texts, tmp_path / "after") == before


def test_what_is_ours_alone_is_short() -> None:
    after = shorten(SOURCES).texts
    left = names(after["parts"]) | names(after["user"])
    gone = {"LIMIT_MM", "_factors", "_factor", "_offset", "_own", "inherited", "pulse_us"}
    assert not left & {*gone, "settings_file", "reader", "amount", "factor", "deep", "machine"}
    assert "_TYPE_CHECKING" in left and "TYPE_CHECKING" not in left
    assert after["parts"].count("\n") == PARTS.count("\n")
    assert after == shorten(SOURCES).texts


def test_an_extra_takes_no_short_name_from_what_every_board_has() -> None:
    """Not even where its attributes are called as variables are, that every board has."""
    count = len(SHORT)
    common = [f"every_{i}" for i in range(count)]
    own = [f"rare_{i}" for i in range(count)]
    usual = "class Usual:\n    def __init__(self):\n" + "".join(
        f"        self.{name} = 0\n" for name in common
    )
    usual += "def f():\n" + "".join(f"    {name} = 0\n" for name in own)
    extra = "class Extra:\n    def __init__(self):\n" + "".join(
        f"        self.{name} = 0\n" for name in own
    )
    extra += "def g(one):\n" + "".join(f"    one.{name} = 1\n" for name in own)
    alone = shorten({"base.usual": usual}).names
    beside = shorten({"base.usual": usual, "extras.extra": extra}).names
    assert len(alone) > count // 2
    assert {name: short for name, short in beside.items() if name in common} == alone


# What a module that few boards have asks strangers' modules for, and what else it says.
_STRANGERS = """import hashlib
import parts
def accept(key, other):
    return hashlib.sha1(key).digest(), {}
"""


def given_away(module: str, more: str) -> "set[str]":
    """Which of these names others have then, who have more than there are short ones for."""
    fields = "".join(f"        self.every_{i} = {i}\n" for i in range(len(SHORT)))
    usual = f"class Usual:\n    def __init__(self):\n{fields}"
    sources = {"base.usual": usual, "parts": "", module: _STRANGERS.format(more)}
    made = shorten(sources)
    assert "hashlib.sha1(" in made.texts[module] and ".digest()" in made.texts[module]
    return {"sha1", "digest"} & set(made.names.values())


@pytest.mark.parametrize(
    ("more", "given"),
    [
        ("0", {"sha1", "digest"}),
        ("other.digest()", {"sha1"}),
        ("parts.sha1", {"digest"}),
        ("(lambda hashlib: hashlib)(key)", set()),
        ("setattr(hashlib, 'sha1', key)", {"digest"}),
        ("[digest for digest in key]", {"sha1"}),
    ],
)
@pytest.mark.parametrize("module", ["extras.rare", "ports.net.radio"])
def test_what_few_boards_ask_of_strangers_others_may_be_called(
    module: str, more: str, given: "set[str]"
) -> None:
    assert given_away(module, more) == given
    assert given_away("ports.port", more) == set(), "most boards have that one"


def test_no_object_has_two_attributes_of_one_name() -> None:
    after = shorten(SOURCES).texts["parts"]
    stored = [
        node.attr
        for node in ast.walk(ast.parse(after))
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
    ]
    assert len(stored) == len(set(stored)) == 5


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("idle_ms", IN + 'self.idle_ms = getattr(self, "idle_ms")'),
        ("f", IN + "self.f = 1"),
        ("block", "import block\n" + IN + "self.block = block"),
        ("append", IN + "self.append = 1"),
        ("duty_u16", IN + "self.duty_u16 = 1  # keep-name: machine.PWM has it, too"),
        ("PWM_MAX", "import board\n" + IN + "self.PWM_MAX = board.PWM_MAX"),
        ("_machine", "import sys\n" + IN + "self._machine = sys.implementation._machine"),
        ("number", IN.replace("A:", "A(Exception):") + "self.number = 1"),
        ("_slow", "class A:\n    _slow = 1\n    fast = _slow"),
        ("Kind", "class Kind:\n    def _method(self):\n        self._method()"),
        ("method", "class Kind:\n    def method(self):\n        self.method()"),
        ("_make_it", MAKER + "class Kind:\n    def _make_it(self):\n        self._make_it()"),
        ("letter", "def f(letter):\n    return 1\nf(letter=1)"),
        ("letter", "def f(letter):\n    return [letter for letter in letter]"),
        ("letter", "def f(letter):\n    def g():\n        nonlocal letter\n        letter = 1"),
        ("ptr", "@micropython.viper\ndef f(ptr: ptr8) -> int:\n    return 1"),
        ("_kept", "_kept = 1\ndef f():\n    global _kept\n    _kept = 2"),
        ("_kept", "_kept = 1\ndef f(_kept=3):\n    return _kept\nf(_kept=1)"),
    ],
)
def test_what_others_may_know_stays(name: str, source: str) -> None:
    assert name in names(shorten({"a": source}).texts["a"])


_NESTED = """class Table:
    ROWS = (
        (30, 31),
        [  # attribute-names: column 1
            (0, "first", "third"),  # a unit, say
            (1, "second", 1),
            (2,),
        ],
        {  # attribute-names: column 0
            5: ("second", "first"),
        },
    )

    def __init__(self):
        self.first = self.second = self.third = 0
"""


def test_names_in_a_marked_column_become_short_and_other_texts_stay() -> None:
    after = shorten({"m": _NESTED})
    first, second = (after.names[name] for name in ("first", "second"))
    for row in (f'(0, "{first}", "third")', f'(1, "{second}", 1)', f'5: ("{second}", "first")'):
        assert row in after.texts["m"]


@pytest.mark.parametrize(
    ("source", "why"),
    [
        (IN + 'self.limits = ["limits"]', "is 'limits' the name of an attribute"),
        ("class A:\n    def _is(self):\n        return '_is'", "is '_is' the name"),
        (_NESTED + '        self.third = "third"', "is 'third' the name of an attribute"),
        (_NESTED.replace("  # attribute-names: column 1", ""), "is 'first' the name"),
        (IN + "self.a = 1\n# keep-name: but which", "does not understand"),
        ("X = 1  # attribute-names: column 1", "does not understand"),
        (IN + "self.limit = 1  # keep-name:", "does not understand"),
    ],
)
def test_a_mark_that_is_missing_or_means_nothing_is_told(source: str, why: str) -> None:
    with pytest.raises(ValueError, match=f"m: .*{why}"):
        shorten({"m": source})


def test_imports_in_vain_go_and_others_stay() -> None:
    sources = {
        "a": "from micropython import const\nimport b\nfrom b import (\n    e,\n    g,\n)\n"
        "X = const(1)\nimport sys\n",
        "b": "from c import h\nfrom micropython import const\ndef f(): pass\ng = const(f)(1)\n",
        "c": "import b\nfrom a import g\nh = b.f\n",
    }
    after = prune(sources)
    assert after["a"] == "pass\npass\nfrom b import g\n\n\n\nX = const(1)\nimport sys\n"
    assert after["b"] == sources["b"].replace("from c import h", "pass")
    assert after["c"] == sources["c"].replace("from a import g", "pass")


# The firmware


@pytest.mark.thorough
def test_public_functions_and_classes_keep_their_names_and_all_their_lines() -> None:
    def told(text: str) -> "list[tuple[str, int]]":
        kinds = ast.FunctionDef | ast.ClassDef
        found = [n for n in ast.walk(ast.parse(text)) if isinstance(n, kinds)]
        return [("" if n.name in private else n.name, n.lineno) for n in found]

    classes = [n for text in build.texts().values() for n in ast.walk(ast.parse(text))]
    methods = [m for n in classes if isinstance(n, ast.ClassDef) for m in private_methods(n)]
    private = {*SHORT, *(method.name for method in methods)}

    before = inline(build.texts())
    after = shorten(prune(before)).texts
    assert {n: told(t) for n, t in after.items()} == {n: told(t) for n, t in before.items()}


# The first 620 names need 9 kB in MicroPython 1.28, one more 4 kB besides: its pools get twice as
# long each time. When 698 are counted here, short ones in ROM apart, there are 599.
_MOST = 716


def test_names_of_the_firmware_fit_into_the_pools_of_a_pico() -> None:
    made = build.for_board(paths.BOARDS / "rpi_pico.py")
    found = {
        name
        for path, content in made.files.items()
        if path.endswith(".mpy") and not path.startswith("extras/")  # which nobody asks for
        for name in mpy_file.names(content)
    }
    assert len(found - set(SHORT)) <= _MOST
    assert not {name for name in found if name.endswith(".py") and name != ".py"}


def test_modules_that_few_boards_have_are_known_by_their_names() -> None:
    assert set(_SELDOM) <= set(build.texts())
