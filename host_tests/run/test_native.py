"""Test kernels compiled for the desktop: same results and exceptions as in Python.

Without a C compiler the firmware runs them as Python.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from array import array
from pathlib import Path

import pytest
from as_users import as_users
from test_both_pythons import PATHS, STANDINS
from ugrbl.compiling import build
from ugrbl.compiling.c_text import NotForC
from ugrbl.paths import EXAMPLES
from ugrbl.run import kernels, native

# Passes of the build and their output: the first ring runs a few.
pytestmark = pytest.mark.thorough

needs_compiler = pytest.mark.skipif(
    os.name != "posix" or not shutil.which(os.environ.get("CC", "cc").split()[0]),
    reason="no C compiler",
)

# A hash of all segments of a program, and its result.
_TRACE = """
import hashlib, json, sys
from ugrbl.run.program import watch_program
from ugrbl.run.recorder import Recorder

class Watcher(Recorder):
    rows = hashlib.sha256()
    def _segment(self, start, row):
        self.rows.update(b"%d %s" % (start, row.tobytes()))
        super()._segment(start, row)

lines = sys.stdin.buffer.read().splitlines()
result, watcher = watch_program(lines, Watcher, "sim", ["$32=1"], None)
from motion.segment_kernel import fill
from language.words import scan
names = [fill.__name__, scan.__name__]
print(json.dumps([result.as_json(), watcher.rows.hexdigest(), names]))
"""
_PYTHON = ["fill", "scan"]  # names of kernels that are not compiled
_MIXED = b"""\
G20 G91 G17 M4 S300
G1 X.5 Y.25 F20
X.01 S900
X.01 S0
G2 X.3 Y0 I.15 J0
G21 G90
G3 X2 Y2 Z1 R30 F900
(a comment) g1x1.00001y-3e ; refused
N17 G0 X0 Y0 Z0
G4 P.1
M5
G38.2 X1
"""


def run(program: bytes, folder: Path, **environment: str) -> "tuple[object, str, list[str]]":
    """Run a program in its own process; return its result, hash of segments, kernel names."""
    done = subprocess.run(
        [sys.executable, "-c", _TRACE],
        input=program,
        capture_output=True,
        check=False,
        env=as_users(UGRBL_KERNELS=str(folder / "kernels"), **environment),
    )
    assert done.returncode == 0, done.stderr.decode()
    result, segments, names = json.loads(done.stdout)
    return result, segments, names


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the library, which a first run compiles."""
    folder = tmp_path_factory.mktemp("native")
    run(b"G0X1\n", folder)
    return folder


@pytest.mark.thorough
@needs_compiler
@pytest.mark.parametrize("program", [_MIXED, (EXAMPLES / "badge.nc").read_bytes()[:20_000]])
def test_compiled_kernels_make_the_same_segments(compiled: Path, program: bytes) -> None:
    *compiled_result, compiled_names = run(program, compiled)
    *python_result, python_names = run(program, compiled, UGRBL_VIPER="fast")
    assert compiled_result == python_result
    # compiled kernels have no names
    assert compiled_names == 2 * ["<lambda>"] and python_names == _PYTHON


@pytest.mark.thorough
@needs_compiler
@pytest.mark.parametrize("part", ["reals", "words", "blocks", "arcs"])
def test_compiled_kernels_compute_the_same_integers(compiled: Path, part: str) -> None:
    """vectors.py prints the results of kernels for many arguments: once compiled, once as Python
    (UGRBL_VIPER=fast)."""
    paths = [str(STANDINS), *map(str, PATHS)]
    script = f"""\
import sys
sys.path[:0] = {paths}
sys.argv[1:] = [{part!r}]
from ugrbl.run import kernels
import micropython
micropython.VIPER = "fast"
kernels.use()
import vectors
vectors.main()
"""
    outputs = []
    for environment in ({}, {"UGRBL_VIPER": "fast"}):
        done = subprocess.run(
            [sys.executable, "-c", script],
            capture_output=True,
            text=True,
            check=False,
            env=as_users(UGRBL_KERNELS=str(compiled / "kernels"), **environment),
        )
        assert done.returncode == 0, done.stderr
        outputs.append(done.stdout)
    assert outputs[0] == outputs[1]
    assert len(outputs[0].splitlines()) > 300  # lines: it did compute


def library(folder: Path, text: str) -> "dict[tuple[str, str], kernels.Kernel]":
    """Compile the kernels of this text; return them by (module, name)."""
    c_file, shared_library = folder / "made.c", folder / "made.so"
    c_file.write_text(native.in_c({"base.made": "import micropython\n" + text}))
    command = [os.environ.get("CC", "cc"), *kernels._FLAGS, "-o", str(shared_library), str(c_file)]
    subprocess.run(command, check=True)
    return kernels._bound(shared_library)


_FAULTS = """
@micropython.viper
def at(p: ptr32, i: int) -> int:
    return p[i]

@micropython.viper
def put(p: ptr16, i: int, value: int) -> int:
    p[i] = value
    return 0

@micropython.viper
def share(a: int, b: int) -> int:
    return a // b

@micropython.viper
def shift(a: int, b: int) -> int:
    return a >> b

@micropython.viper
def ask(who: object) -> int:
    answer = int(who(7))
    return answer + 1

@micropython.viper
def say(who: object) -> int:
    who(7)
    return 1

@micropython.viper
def parts(held: object) -> int:
    words, halves, who, number = held
    if who:
        return int(who(words, ptr16(halves)[1], words))
    ptr32(words)[0] = int(number)
    return ptr32(words)[0]

@micropython.viper
def mixed(p: ptr32, k: int, a: int) -> int:
    q = ptr8(p)
    p[k] += a
    q[4] |= 1
    total = 0
    for i in range(1, 4):
        if i == 2:
            continue
        total = total * 10 + i
    return (total or a) + (a and k) + ((0 - a) % 7) + ((0 - a) // 7) + (not a)
"""


@needs_compiler
def test_kernel_raises_where_a_fault_would_be_silent(tmp_path: Path) -> None:
    """In C a wrong index, overflow, division or type would be silent or crash; exceptions of
    called functions are passed on."""
    compiled_kernels = {name: kernel for (_, name), kernel in library(tmp_path, _FAULTS).items()}
    words, halves = array("i", [5, 6]), array("H", [0, 0])
    assert compiled_kernels["at"](words, 1) == 6
    for index in (2, -1):
        with pytest.raises(IndexError):
            compiled_kernels["at"](words, index)
    compiled_kernels["put"](halves, 1, 0xFFFF)
    for value in (-1, 0x10000):
        with pytest.raises(OverflowError):
            compiled_kernels["put"](halves, 1, value)
    assert halves[1] == 0xFFFF
    assert compiled_kernels["share"](-7, 2) == -4
    with pytest.raises(ZeroDivisionError):
        compiled_kernels["share"](1, 0)
    assert compiled_kernels["shift"](-5, 1) == -3
    with pytest.raises(OverflowError):
        compiled_kernels["shift"](1, 32)
    with pytest.raises(KeyError):
        compiled_kernels["ask"]({}.__getitem__)
    assert compiled_kernels["ask"]({7: 8}.__getitem__) == 9
    said: list[int] = []
    assert compiled_kernels["say"](said.append) == 1
    assert said == [7]
    with pytest.raises(KeyError):
        compiled_kernels["say"]({}.__getitem__)
    arguments: list[object] = []
    assert (
        compiled_kernels["parts"]((words, halves, lambda *all: arguments.extend(all) or 4, None))
        == 4
    )
    assert arguments == [words, 0xFFFF, words]
    assert compiled_kernels["parts"]((words, halves, None, 5)) == 5
    for wrong_tuple, error in (
        (None, SystemError),  # not a tuple
        ((words, halves, None), ValueError),
        ((words, halves, None, "five"), TypeError),
        ((words, halves, {}.fromkeys, 5), TypeError),
        ((3, halves, None, 5), TypeError),
        ((words, 3, max, 5), TypeError),
    ):
        with pytest.raises(error):
            compiled_kernels["parts"](wrong_tuple)
    # total 13, of digits 1 and 3; (a and k) is k: 1; -3 % 7: 4; -3 // 7: -1; not a: 0
    assert compiled_kernels["mixed"](words, 1, 3) == 13 + 1 + 4 - 1
    assert list(words) == [5, 9]  # words[1] = 6 + 3; q[4] is its lowest byte
    assert compiled_kernels["at"](memoryview(words)[1:], 0) == 9


@needs_compiler
def test_read_only_view_is_read_unchanged(tmp_path: Path) -> None:
    """A buffer that C cannot get writable is copied for the call."""
    text = "@micropython.viper\ndef at(p: ptr8, i: int) -> int:\n    return p[i]\n"
    (read,) = library(tmp_path, text).values()
    for byte in range(256):  # the memory of a copy freed too early would soon hold other bytes
        assert [read(memoryview(bytes([byte]) * 8), i) for i in range(8)] == [byte] * 8


@pytest.mark.sampled(1)
def test_every_kernel_is_translated() -> None:
    translated = set(re.findall(r'^ +"(\S+) (\S+)', native.in_c(build.texts()), re.MULTILINE))
    assert {("motion.plan_kernel", "plan_block"), ("language.line", "commit_modal")} <= translated
    assert len(translated) > 120


def test_unknown_form_is_refused() -> None:
    text = "@micropython.viper\ndef f(a: int) -> int:\n    return strange(a)\n"
    with pytest.raises(NotForC, match=r"strange\(a\)"):
        native.in_c({"base.made": text})


def test_missing_compiler_leaves_the_kernels_as_python(tmp_path: Path) -> None:
    assert run(b"G0X1\n", tmp_path, CC="no-such-compiler")[2] == _PYTHON
    assert not (tmp_path / "kernels").exists()


def test_missing_cache_folder_leaves_the_kernels_as_python(tmp_path: Path) -> None:
    (tmp_path / "kernels").write_text("a file where the folder would be")
    assert run(b"G0X1\n", tmp_path)[2] == _PYTHON


@pytest.mark.thorough
@needs_compiler
def test_invalid_library_is_not_used(tmp_path: Path) -> None:
    run(b"G0X1\n", tmp_path)  # compiles it
    (library,) = (tmp_path / "kernels").glob("*.so")
    library.write_bytes(b"cut short")
    assert run(b"G0X1\n", tmp_path)[2] == _PYTHON


@needs_compiler
def test_failing_compiler_is_run_once(tmp_path: Path) -> None:
    """Its failure is remembered in the cache folder. Each run of this compiler adds a line to
    `asked`."""
    failing = tmp_path / "cc"
    failing.write_text(f"#!/bin/sh\necho >> {tmp_path}/asked\necho no headers >&2\nexit 1\n")
    failing.chmod(0o755)
    for _ in range(2):
        assert run(b"G0X1\n", tmp_path, CC=str(failing))[2] == _PYTHON
    assert (tmp_path / "asked").read_text() == "\n"
    assert "no headers" in next((tmp_path / "kernels").glob("*.log")).read_text()
