"""The micropython stand-in: viper arithmetic raises where the board would silently overflow."""

import traceback
from array import array
from importlib import import_module, reload
from pathlib import Path

import machine
import micropython
import pytest
from hypothesis import given
from hypothesis import strategies as st
from micropython import const, viper

words = st.integers(-(2**31), 2**31 - 1)

_LIMIT = const(1 << 30)
_HALF = const(0.5)


@viper
def add(a: int, b: int) -> int:
    return a + b


@viper
def subtract(a: int, b: int) -> int:
    return a - b


@viper
def multiply(a: int, b: int) -> int:
    return a * b


@viper
def divide(a: int, b: int) -> int:
    return a // b


@viper
def modulo(a: int, b: int) -> int:
    return a % b


@viper
def negate(a: int) -> int:
    return -a


@viper
def shift_left(a: int, n: int) -> int:
    return a << n


@viper
def shift_right(a: int, n: int) -> int:
    return a >> n


@viper
def load8(p: ptr8, i: int) -> int:
    return p[i]


@viper
def load16(p: ptr16, i: int) -> int:
    return p[i]


@viper
def load32(p: ptr32, i: int) -> int:
    return p[i]


@viper
def store8(p: ptr8, i: int, value: int) -> int:
    p[i] = value
    return 0


@viper
def store32(p: ptr32, i: int, value: int) -> int:
    p[i] = value
    return 0


@viper
def accumulate(p: ptr32, i: int, value: int) -> int:
    p[i] += value
    return p[i]


@viper
def load_in_body(memory: object, i: int) -> int:
    p = ptr32(memory)
    return p[i]


@viper
def forward(p: ptr32, i: int) -> int:
    return int(load32(p, i))


@viper
def unsigned(a: int) -> uint:
    return uint(a)


@viper
def keep_uint(a: uint) -> uint:
    return a


@viper
def count_up(n: int) -> int:
    """Count."""
    total = 0
    for i in range(n):
        total += i
        if total > 1000 and not i & 1:
            break
    return total


def exact_or_raises(kernel, a, b, exact):
    """Check that the kernel returns the exact result, or raises if that needs more than 32
    bits."""
    if -(2**31) <= exact < 2**31:
        assert kernel(a, b) == exact
    else:
        with pytest.raises(OverflowError):
            kernel(a, b)


@given(words, words)
def test_results_are_exact_or_raise(a, b):
    exact_or_raises(add, a, b, a + b)
    exact_or_raises(subtract, a, b, a - b)
    exact_or_raises(multiply, a, b, a * b)
    if b:
        exact_or_raises(divide, a, b, a // b)
        exact_or_raises(modulo, a, b, a % b)


@given(words, st.integers(0, 31))
def test_shifts_are_exact_or_raise(a, n):
    exact_or_raises(shift_left, a, n, a << n)
    assert shift_right(a, n) == a >> n


@pytest.mark.parametrize("kernel", [shift_left, shift_right])
@pytest.mark.parametrize("count", [-1, 32])
def test_shift_counts_undefined_on_the_chip_raise(kernel, count):
    with pytest.raises(OverflowError):
        kernel(1, count)


def test_negating_the_lowest_word_raises():
    with pytest.raises(OverflowError):
        negate(-(2**31))


@pytest.mark.parametrize("kernel", [divide, modulo])
def test_division_by_zero_raises(kernel):
    with pytest.raises(ZeroDivisionError):
        kernel(1, 0)


@pytest.mark.parametrize("bad", [1.0, None, "1"])
def test_only_integers_are_accepted_as_int(bad):
    with pytest.raises(TypeError):
        add(bad, 1)


def test_an_argument_wider_than_a_word_raises():
    with pytest.raises(OverflowError):
        add(2**31, 0)


def test_uint_reads_a_word_as_unsigned():
    assert unsigned(-1) == keep_uint(2**32 - 1) == 2**32 - 1
    with pytest.raises(OverflowError):
        keep_uint(-1)


@pytest.mark.parametrize(
    "memory",
    [
        array("i", [7, -2]),
        array("I", [7, 2**32 - 2]),
        bytearray(b"\x07\0\0\0\xfe\xff\xff\xff"),
        b"\x07\0\0\0\xfe\xff\xff\xff",
        memoryview(array("i", [7, -2])),
        memoryview(bytearray(b"\x09\0\0\0\x07\0\0\0\xfe\xff\xff\xff"))[4:],
    ],
)
def test_any_buffer_is_read_as_signed_words(memory):
    """load32 has a ptr32 as its parameter, forward passes it on, load_in_body makes one of an
    object."""
    for load in (load32, forward, load_in_body):
        assert (load(memory, 0), load(memory, 1)) == (7, -2)


def test_floats_in_an_array_are_read_as_their_bits():
    assert load32(array("f", [1.0]), 0) == 0x3F800000


def test_short_pointers_are_unsigned():
    memory = array("i", [-2])
    assert load8(memory, 0) == 0xFE
    assert load16(memory, 0) == 0xFFFE


def test_stores_change_the_array():
    memory = array("i", [1, 2])
    store32(memory, 1, -5)
    assert accumulate(memory, 1, -5) == -10  # -5 - 5
    assert memory == array("i", [1, -10])


def test_a_sum_stored_by_augmented_assignment_is_checked():
    with pytest.raises(OverflowError):
        accumulate(array("i", [2**31 - 1]), 0, 1)


@pytest.mark.parametrize("value", [-1, 256])
def test_a_byte_out_of_range_raises(value):
    with pytest.raises(ValueError, match="format"):
        store8(bytearray(1), 0, value)


@pytest.mark.parametrize("index", [-1, 2])
def test_indices_outside_the_buffer_raise(index):
    memory = array("i", [1, 2])
    for access in (lambda: load32(memory, index), lambda: accumulate(memory, index, 1)):
        with pytest.raises(IndexError):
            access()


def test_a_pointer_to_no_buffer_raises():
    with pytest.raises(TypeError):
        load32(0xD0000000, 0)


def test_a_pointer_to_a_register_reads_mem32_as_signed():
    """An int as a pointer is an address of hardware: index 2 is 8 bytes further on."""
    store32(0x40014004, 2, -2)
    assert machine.mem32[0x4001400C] == 0xFFFFFFFE
    assert load32(0x4001400C, 0) == -2
    machine.mem32[0x4001400C] = 0


def test_new_arrays_are_not_confused_with_old_ones():
    for n in range(3000):  # more than the stand-in caches, and at recycled addresses
        assert load32(array("i", [n]), 0) == n


def test_name_docstring_and_control_flow_are_kept():
    assert count_up.__name__ == count_up.__qualname__ == "count_up"
    assert count_up.__doc__ == "Count."
    # 0 + … + 46 = 1081 is the first sum above 1000 at an even i
    assert [count_up(n) for n in (0, 5, 100)] == [0, 10, 1081]


def test_a_traceback_shows_the_line_of_the_kernel():
    """The stand-in compiles kernels anew, with checks; tracebacks still show the source."""
    with pytest.raises(OverflowError) as caught:
        multiply(2**30, 4)
    frames = traceback.extract_tb(caught.tb)
    assert any(f.name == "multiply" and f.line == "return a * b" for f in frames)


def default_argument(a: int = 1) -> int:
    return a


def star_arguments(*a: int) -> int:
    return 0


def float_literal(a: int) -> int:
    return int(a < 1.5)


def float_constant(a: int) -> int:
    return int(a < _HALF)


def true_division(a: int) -> int:
    return a / 2


def large_literal(a: int) -> int:
    return a & 0x40000000


def large_constant(a: int) -> int:
    return a & _LIMIT


def none_as_result(p: ptr32) -> None:
    p[0] = 0


def quoted_annotation(p: "ptr32") -> int:
    return p[0]


def tuple_assignment(a: int, b: int) -> int:
    a, b = b, a
    return a


def inner_function(a: int) -> int:
    double = lambda: a + a  # noqa: E731
    return double()


@pytest.mark.parametrize(
    "function",
    [
        default_argument,
        star_arguments,
        float_literal,
        float_constant,
        true_division,
        large_literal,
        large_constant,
        none_as_result,
        quoted_annotation,
        tuple_assignment,
        inner_function,
    ],
    ids=lambda function: function.__name__,
)
def test_constructs_unsupported_on_the_board_are_refused_at_decoration(function):
    """The error names the function and its line in this file."""
    with pytest.raises(SyntaxError, match=function.__name__) as caught:
        viper(function)
    assert caught.value.filename == __file__
    assert caught.value.lineno >= function.__code__.co_firstlineno


def test_locals_of_an_outer_function_are_refused():
    """Viper has no closures."""
    outer = 1

    def closure(a: int) -> int:
        return a + outer

    with pytest.raises(SyntaxError, match="locals"):
        viper(closure)


def test_large_literals_are_allowed_inside_int():
    """Literals from 2**30 are objects on the board; int() makes machine words of them."""

    @viper
    def mask(a: int) -> int:
        return (a & int(0x7FFFFFFF)) | int(-0x80000000)

    @viper
    def limit() -> int:
        return int(_LIMIT)

    assert mask(5) == 5 - 2**31
    assert limit() == 2**30


def test_methods_can_be_viper():
    class Counter:
        @viper
        def twice(self, n: int) -> int:
            return n + n

    assert Counter().twice(4) == 8
    with pytest.raises(OverflowError):
        Counter().twice(2**30)


def test_objects_can_be_unpacked():
    @viper
    def difference(pair: object) -> int:
        first, second = pair
        return int(first) - int(second)

    assert difference((7, 3)) == 4


def test_fast_mode_casts_pointers_and_checks_nothing(monkeypatch):
    monkeypatch.setattr(micropython, "VIPER", "fast")

    @viper
    def scaled(p: ptr32, factor: int) -> int:
        return p[1] * factor

    # 2**32 - 3 is read as -3; the product exceeds 32 bits
    assert scaled(array("I", [0, 2**32 - 3]), 2**31) == -3 * 2**31


def test_unsupported_names_of_micropython_are_missing():
    with pytest.raises(AttributeError):
        _ = micropython.qstr_info


_KEPT = """
from micropython import viper
from kept_numbers import AT

@viper
def at(p: ptr8, n: int) -> int:
    return p[AT] + n
"""


def test_the_cached_function_depends_on_its_current_constants(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stand-in caches compiled kernels in build/cache; a changed constant (AT) makes another
    entry."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(micropython, "_ROOT", tmp_path)
    (tmp_path / "firmware").mkdir()  # only a checkout has a cache
    (tmp_path / "kept_function.py").write_text(_KEPT)
    (tmp_path / "kept_numbers.py").write_text("AT = 1\n")
    function, numbers = import_module("kept_function"), import_module("kept_numbers")
    assert function.at(b"abc", 1) == ord("b") + 1
    cached_files = [*(tmp_path / "build" / "cache").iterdir()]
    with monkeypatch.context() as patch:
        patch.setattr(micropython, "_compiled", None)  # nothing may be compiled again
        assert reload(function).at(b"abc", 2) == ord("b") + 2
    numbers.AT = -1
    with pytest.raises(IndexError, match="-1 is before the start"):
        reload(function).at(b"abc", 1)
    assert len(cached_files) == 1 and len([*(tmp_path / "build" / "cache").iterdir()]) == 2
