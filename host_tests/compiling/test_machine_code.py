"""Test that machine code of kernels does the same as the Python functions, at any address."""

import subprocess
import sys
from array import array
from pathlib import Path

import pytest
from as_users import as_users
from test_both_pythons import PATHS, STANDINS
from ugrbl.compiling import compilers, machine_code

pytest.importorskip("unicorn")
if not compilers.llvm_is_there():
    pytest.skip("ziglang is not installed", allow_module_level=True)

from arm_model import CODE, Board, c_of, kernels_of

pytestmark = [pytest.mark.xdist_group("machine code"), pytest.mark.thorough]


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> "dict[str, Path]":
    """Write a file for each processor, with all kernels of a board (arm_model.kernels_of())."""
    files = {arch: tmp_path_factory.mktemp("kernels") / arch for arch in compilers.PROCESSORS}
    for arch, file in files.items():
        file.write_text(repr(kernels_of(arch)))
    return files


def output_of_vectors(part: str, arch: str = "", file: "Path | None" = None) -> str:
    """Return what vectors.py prints for this part: as Python, or by the machine code in `file` on
    a model of the processor `arch`."""
    script = f"""\
import sys
sys.path[:0] = {[str(STANDINS), *map(str, PATHS)]}
sys.argv[1:] = [{part!r}]
import micropython
micropython.VIPER = "fast"
if {arch!r}:
    import arm_model, ast, pathlib
    c, keys = ast.literal_eval(pathlib.Path({str(file)!r}).read_text())
    arm_model.use(arm_model.Board(c, keys, {arch!r}))
import vectors
vectors.main()
"""
    environment = as_users(UGRBL_VIPER="fast")
    command = [sys.executable, "-c", script]
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.thorough
@pytest.mark.parametrize("part", ["reals", "words", "blocks", "arcs"])
def test_machine_code_computes_the_same_integers(kernels: "dict[str, Path]", part: str) -> None:
    expected = output_of_vectors(part)
    assert len(expected.splitlines()) > 300  # lines: it did compute
    for arch, file in kernels.items():
        assert output_of_vectors(part, arch, file) == expected, arch


_KERNELS = """
@micropython.viper
def share(a: int, b: int) -> int:
    return a // b + 1000 * (a % b)

@micropython.viper
def wraps(a: int, b: int) -> int:
    return (a * b) ^ (a << 3) ^ (a >> 5)

@micropython.viper
def mixed(p: ptr32, k: int, a: int) -> int:
    q = ptr8(p)
    h = ptr16(int(p) + 4)
    p[k] += a
    q[0] |= 1
    h[1] = 0xFFFF
    total = 0
    for i in range(1, 4):
        if i == 2:
            continue
        total = total * 10 + i
    return (total or a) + (a and k) + (not a)

@micropython.viper
def through(p: ptr32, k: int) -> int:
    return int(mixed(int(p) + 4, k, 3)) + int(share(7, 2))

@micropython.viper
def ask(who: object, a: int) -> int:
    answer = int(who(a, 5))
    who()
    return answer + 1

@micropython.viper
def is_there(who: object, a: int) -> int:
    if who:
        return a
    return 0

@micropython.viper
def none() -> int:
    return 0x7FFFFFFF
"""


@pytest.fixture(scope="module", params=[*compilers.PROCESSORS])
def board(request: pytest.FixtureRequest) -> Board:
    """Return the test kernels, loaded on a model of each processor."""
    return Board(*c_of(_KERNELS), request.param)


def test_machine_code_matches_viper(board: Board) -> None:
    # Division rounds down: 7 // 2 + 1000 * (7 % 2) = 3 + 1000
    for a, b, expected in ((7, 2, 1003), (-7, 2, 996), (7, -2, -1004), (-7, -2, -997)):
        assert board.call(("made", "share"), a, b) == expected
    a, b = 0x12345678, -0x7654321
    wrapped = (a * b) ^ (a << 3) ^ (a >> 5)
    # 32 bits, signed
    assert board.call(("made", "wraps"), a, b) == (wrapped + 2**31) % 2**32 - 2**31
    words = array("i", [6, 7, 8])
    # total: digits 1 and 3; (a and k) is k
    assert board.call(("made", "mixed"), words, 2, 3) == 13 + 2
    assert list(words) == [7, 7 | -1 << 16, 11]  # 6 | 1; the upper half of words[1] set; 8 + 3
    assert board.call(("made", "none")) == 0x7FFFFFFF


def test_address_may_be_passed_as_a_pointer(board: Board) -> None:
    """through() passes the address of words[1] to mixed(), which returns 13 + k (1), and adds
    share(7, 2) = 1003."""
    words = array("i", [1, 2, 3])
    assert board.call(("made", "through"), words, 1) == 13 + 1 + 1003
    assert list(words) == [1, 3, 3 + 3 | -1 << 16]


def test_object_is_called_with_objects(board: Board) -> None:
    """ask() calls who(a, 5), then who(), and returns the first result plus 1. a needs more than 30
    bits, so it is no small integer on the board."""
    calls: list[tuple[int, ...]] = []

    def who(*arguments: int) -> int:
        calls.append(arguments)
        return sum(arguments)

    assert board.call(("made", "ask"), who, -(1 << 30) - 5) == -(1 << 30) + 1
    assert calls == [(-(1 << 30) - 5, 5), ()]


def test_none_differs_from_an_existing_object(board: Board) -> None:
    assert board.call(("made", "is_there"), None, 5) == 0
    assert board.call(("made", "is_there"), print, 5) == 5


@pytest.mark.parametrize("arch", compilers.PROCESSORS)
def test_machine_code_runs_at_any_address(arch: str) -> None:
    for offset in (16, 0x12340):
        board = Board(*c_of(_KERNELS), arch, offset)
        assert all(code >= CODE + offset for code in board.functions.values())
        assert board.call(("made", "share"), 7, 2) == 1003


def test_only_requested_kernels_are_linked() -> None:
    """Machine code of one kernel is less than a fifth of that of all."""
    c_text, keys = kernels_of("armv6m")
    fill = ("motion.segment_kernel", "fill")
    one_size, full_size = (
        len(machine_code.linked(c_text, "armv6m", tuple(wanted))) for wanted in ([fill], keys)
    )
    assert one_size < full_size / 5
    assert list(Board(c_text, [fill]).functions) == [fill]


def test_compiler_refusal_is_reported() -> None:
    with pytest.raises(compilers.CompilerError, match="share"):
        machine_code.compiled("int share(void) { return missing; }", "armv6m")
