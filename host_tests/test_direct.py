"""Viper functions that call one another without MicroPython: they do what they did."""

import pytest
from thumb_model import CODE, Run
from ugrbl.boardfile.files import board_file
from ugrbl.compiling import build, calling, direct, mpy

_SOURCE = """
import micropython

@micropython.viper
def two(a: int, b: int) -> int:
    return a - b

@micropython.viper
def store(to: ptr32, at: int, value: int) -> int:
    if value < 0:
        to[at] = 0 - value
        return at
    to[at] = value
    return at + 1

@micropython.viper
def many(to: ptr32, at: int, a: int, b: int, thing: object, c: int) -> int:
    at = int(store(to, at, a + b))
    at = int(store(to, at, int(two(c, -1)) if a > b else 100000))
    store(to, at, 3)
    store(to, at + 1, int(thing))
    return at + 2

@micropython.viper
def outer(to: ptr32, from_: ptr8, count: int) -> int:
    at = 0
    for i in range(count):
        c = from_[i]
        at = int(many(to, at, c, i << 4, thing, int(two(count, int(two(c, 7))))))
        at = int(store(to, at, -5))
        many(to, at, -1, 255, thing, 256)
    return int(two(at, count))
"""
_PLACES = 11  # where one of them calls another
_NAMES = ("two", "store", "many", "outer")

_OBJECTS = 0x1000_0000
_TABLE = 0x1100_0000
_RUNTIME = 0x4000_0000
_FROM, _TO, _SWAP, _LOOK_UP, _CALL = 12, 16, 20, 28, 108
_MASK = 0xFFFFFFFF


class Board(Run):
    """Functions at their places in memory, and of MicroPython what they ask of it."""

    def __init__(self, compiled: bytes, seed: int) -> None:
        super().__init__(b"", seed)
        self._names = mpy.names(compiled)
        self.calls: "list[str]" = []  # that go by way of MicroPython
        self.looked_up: "list[str]" = []
        self._memory[_OBJECTS + 0x800 + 4], self._memory[_OBJECTS + 0x900] = 0, 1
        context = _OBJECTS + 0x900
        self._memory |= {
            context + 4: 0,
            context + 8: context + 0x100,
            context + 12: _TABLE + 0x1000,
        }
        for k in range(64):
            self._memory[context + 0x100 + 2 * k] = k  # names
            self._memory[_TABLE + 0x1000 + 4 * k] = _TABLE  # whichever constant it is
            self._memory[_TABLE + 4 * k] = _RUNTIME + 4 * k
        self._objects: dict[str, int] = {}
        for i, (name, code) in enumerate(zip(_NAMES, mpy.vipers(compiled), strict=True)):
            self._objects[name] = at = _OBJECTS + 64 * i
            self._memory |= {at: 4, at + 4: context, at + 12: CODE + len(self._code)}
            self._code += code + bytes(-len(code) % 4)

    def run(self, name: str, *arguments: int) -> "tuple[int, dict[int, int]]":
        """Call a function with objects. Returns its result, and what is at 0x1800_0000."""
        for i, each in enumerate(arguments):
            self._memory[_OBJECTS + 0x400 + 4 * i] = each & _MASK
        function = self._objects[name]
        self._r[:4] = function, len(arguments), 0, _OBJECTS + 0x400
        self._r[15] = self._memory[function + 12]
        assert self.go(20_000)[-1][0] == "ends"
        return self._r[0], {at: x for at, x in self._memory.items() if at >> 24 == 0x18}

    def _call(self, function: int) -> None:
        if function < _RUNTIME:
            self._r[14], self._r[15] = self._r[15] | 1, function & ~1
            return
        a, b, c = self._r[:3]
        self._r[1:4] = [self._any() for _ in range(3)]
        match function - _RUNTIME:
            case where if where == _FROM:
                self._r[0] = (a >> 1 | (a & 1 << 31)) & _MASK if a & 1 else a + 64
            case where if where == _TO:
                self._r[0] = a << 1 & _MASK | 1
            case where if where == _SWAP:
                self._r[0] = 0
            case where if where == _LOOK_UP:
                self.looked_up.append(self._names[a])
                self._r[0] = self._objects.get(self._names[a], 2 * 21 + 1)
            case where:
                assert where == _CALL, hex(where)
                self.calls.append(next(n for n, at in self._objects.items() if at == a))
                self._r[:4] = a, b, 0, c
                self._r[14], self._r[15] = self._r[15] | 1, self._memory[a + 12]


@pytest.fixture(scope="module")
def compiled() -> bytes:
    return build._compile("made", _SOURCE, "armv6m", False)


@pytest.mark.parametrize("constants", [0, 40])  # objects, with which MicroPython's table stands
@pytest.mark.parametrize("seed", range(8))
def test_functions_that_call_one_another_do_the_same(seed: int, constants: int) -> None:
    source = _SOURCE + "".join([f"print({n}.5)\n" for n in range(constants)])
    plain = build._compile("made", source, "armv6m", False)
    linked = direct.linked({"made": plain}, {"made": source})["made"]
    found = []
    for code in (plain, linked):
        board = Board(code, seed)
        board._memory |= {0x1800_8000 + 64 + i: 3 + 40 * i * seed & 255 for i in range(6)}
        found.append((board, board.run("outer", 0x1800_0000, 0x1800_8000, 2 * 6 + 1)))
    (before, due), (after, made) = found
    assert made == due and len(due[1]) > 25
    assert len(before.calls) > 50 and not after.calls
    functions = [name for name in after.looked_up if name in _NAMES]
    assert len(functions) == _PLACES, "each looks up once"


def test_who_has_objects_to_give_is_taken_as_before(compiled: bytes) -> None:
    linked = direct.linked({"made": compiled}, {"made": _SOURCE})["made"]
    assert Board(linked, 1).run("two", 2 * 7 + 1, 2 * -3 + 1)[0] == 2 * 10 + 1


@pytest.mark.parametrize(
    "line", ["two = outer", "def f():\n    global two", "import made\nmade.two = 3"]
)
def test_a_function_that_may_be_another_is_looked_up(line: str) -> None:
    source = f"{_SOURCE}\n{line}\n"
    made = direct.linked(
        {"made": build._compile("made", source, "armv6m", False)}, {"made": source}
    )["made"]
    board = Board(made, 1)
    board._memory |= {0x1800_8000 + 64: 3}
    board.run("outer", 0x1800_0000, 0x1800_8000, 2 * 1 + 1)
    assert set(board.calls) == {"two"}


def test_nearly_all_calls_of_a_pico_go_that_way(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    usual = calling._Call.redirect

    def redirect(call: calling._Call, live: int) -> bool:
        is_ours = call._entry() is not None
        done = usual(call, live)
        if is_ours:
            asked.append(done)
        return done

    monkeypatch.setattr(calling._Call, "redirect", redirect)
    direct._rewritten.cache_clear()  # other tests have built the same
    build.for_board(board_file("rpi_pico"))
    assert sum(asked) > 0.8 * len(asked) > 25
