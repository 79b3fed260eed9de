"""Test that constants inlined across modules keep the meaning and the line numbers."""

import re
import sys
from types import ModuleType, SimpleNamespace

from ugrbl.compiling.inline import inline
from ugrbl.paths import FIRMWARE

KINDS = """from micropython import const

NAME = const(3)
SHIFTED = const(NAME << 4 | 1)
_OWN = const(7)
NEGATIVE = const(-2)
CHOSEN = const(False)
TEXT = "no number"
LATER = const(5)
LATER = 6


def double(x):
    return x * NAME + _OWN
"""

USER = """import kinds
import kinds as k
from kinds import (
    NAME,
    SHIFTED,
    double,
)
from kinds import NEGATIVE as LEAST

É = "é", NAME, k.SHIFTED, kinds.TEXT, k.LATER, k.CHOSEN


def f(kinds):
    return kinds.NAME, LEAST, double(NAME), 2 - LEAST
"""


def run_both(sources: "dict[str, str]") -> "dict[str, object]":
    """Run both modules; return what the user's module computes: É, and f() with another
    `kinds`."""
    module = ModuleType("kinds")
    vars(module)["const"] = lambda value: value  # not imported any more: the compiler resolves it
    exec(sources["kinds"], vars(module))
    sys.modules["kinds"] = module
    try:
        values: dict[str, object] = {}
        exec(sources["user"], values)
        f = values["f"]
        assert callable(f)
        return {"É": values["É"], "f": f(SimpleNamespace(NAME=99))}
    finally:
        del sys.modules["kinds"]


def test_inlined_module_gives_the_same_results() -> None:
    before = {"kinds": KINDS, "user": USER}
    assert run_both(inline(before)) == run_both(before)
    # 49 = 3 << 4 | 1; 16 = double(3) = 3 * 3 + 7; LATER is 6 at the end
    assert run_both(before) == {"É": ("é", 3, 49, "no number", 6, False), "f": (99, -2, 16, 4)}


def test_numbers_replace_names_and_no_line_moves() -> None:
    inlined = inline({"kinds": KINDS, "user": USER})
    assert inlined["kinds"].count("\n") == KINDS.count("\n")
    lines = inlined["user"].splitlines()
    assert lines[2] == "from kinds import double" and lines[7] == "pass"
    assert lines[9] == 'É = "é", 3, 49, kinds.TEXT, k.LATER, False'
    # The parameter `kinds` hides the module, so kinds.NAME stays.
    assert lines[13] == "    return kinds.NAME, (-2), double(3), 2 - (-2)"
    # the definition is removed; _OWN is left to the compiler
    assert "NAME = const" not in inlined["kinds"] and "x * 3 + _OWN" in inlined["kinds"]


def test_every_constant_of_the_firmware_is_inlined() -> None:
    """Public constants disappear from all modules; line numbers stay."""
    sources = {
        ".".join(file.relative_to(FIRMWARE).with_suffix("").parts): file.read_text("utf-8")
        for file in FIRMWARE.rglob("*.py")
    }
    public = re.compile(r"^([A-Z]\w*) = const\(", re.MULTILINE)
    assert sum(len(public.findall(text)) for text in sources.values()) > 200
    for name, text in inline(sources).items():
        assert text.count("\n") == sources[name].count("\n")
        assert not public.findall(text), name
