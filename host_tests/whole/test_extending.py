"""The instructions of docs/extending.md, executed: its changes in a copy of the tree."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

# Each in its own tree: half a minute.
pytestmark = pytest.mark.thorough

_ROOT = Path(__file__).resolve().parents[2]
_PAGE = _ROOT / "docs" / "extending.md"
_COPIED = ("firmware", "boards", "tools", "host_tests", "examples", "docs", "pyproject.toml")
_LEFT_OUT = shutil.ignore_patterns("__pycache__", "pictures", "*.png")

_BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SECTION = re.compile(r"^## (.*)$", re.MULTILINE)
_ROW = re.compile(r"^\| \[(.*?)\]\(.*?\) \| (\d+) \| (\d+) \|$", re.MULTILINE)


class Change(NamedTuple):
    """A block of the page: a new file, or changes to one."""

    path: str
    kind: str
    text: str


def changes(title):
    """Yield the changes of a section of the page: its blocks of code, as Change.

    A block "diff" begins with a line `--- path`. Others are new files, named after the language:
    "python boards/x.py".
    """
    parts = _SECTION.split(_PAGE.read_text(encoding="utf-8"))
    section = dict(zip(parts[1::2], parts[2::2], strict=True))[title]
    for kind, path, text in _BLOCK.findall(section):
        if kind == "diff":
            head, _, diff = text.partition("\n")
            assert head.startswith("--- ")
            yield Change(head[4:], kind, diff)
        else:
            assert path, f"{title}: a block must name its file"
            yield Change(path, kind, text)


def apply(text, diff):
    """Return the text with the changes of a unified diff; each must fit in exactly one place.

    Line numbers of the diff (@@) are ignored. An empty line in it is an empty line of context.
    """
    for hunk in re.split(r"^@@.*\n", diff, flags=re.MULTILINE):
        lines = [line if line.strip() else " \n" for line in hunk.splitlines(keepends=True)]
        old = "".join(line[1:] for line in lines if line[0] in " -")
        new = "".join(line[1:] for line in lines if line[0] in " +")
        offsets = [
            match.start() for match in re.finditer(f"^{re.escape(old)}", text, re.MULTILINE)
        ]
        assert len(offsets) == 1, f"{len(offsets)} places for:\n{old}"
        text = text[: offsets[0]] + new + text[offsets[0] + len(old) :]
    return text


class Tree:
    """A copy of the needed parts of the tree, with the changes of a section of the page."""

    def __init__(self, folder, title):
        """Copy the tree to folder and apply the changes of the section with this title."""
        self.folder = folder
        for name in _COPIED:
            source = _ROOT / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=_LEFT_OUT)
            else:
                shutil.copy(source, folder / name)
        (folder / "ugrbl").symlink_to(folder / "tools")  # the package's name when installed
        (folder / "build").mkdir()
        # A cache entry is named after its sources: changed files miss it, all others hit.
        (_ROOT / "build" / "cache").mkdir(parents=True, exist_ok=True)
        (folder / "build" / "cache").symlink_to(_ROOT / "build" / "cache")
        self.written = set()  # files of the changes
        for change in changes(title):
            file = folder / change.path
            text = change.text
            if change.kind == "diff":
                text = apply(file.read_text(encoding="utf-8"), change.text)
            else:
                assert not file.exists()
            file.write_text(text, encoding="utf-8")
            self.written.add(change.path)

    def python(self, *words):
        """Run this Python with this tree instead of ours; return its output. words: its
        arguments."""
        done = subprocess.run(
            [sys.executable, *words],
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def ugrbl(self, line):
        """Run a command of the page."""
        assert f"    ugrbl {line}\n" in _PAGE.read_text(encoding="utf-8")
        return self.python("-m", "ugrbl.cli", *line.split())

    def make_docs(self):
        """Update the docs; return the changed files."""
        output = self.python("-m", "ugrbl.docs")
        return set(re.findall(r"^(\S+) has been brought up to date$", output, re.MULTILINE))


@pytest.fixture
def tree(request, tmp_path):
    return Tree(tmp_path, request.param)


def in_section(title):
    return pytest.mark.parametrize("tree", [title], indirect=True)


def file_counts_on_page(what):
    """Return how many files the page says are written by hand, and updated by `make docs`."""
    rows = {row[0]: (int(row[1]), int(row[2])) for row in _ROW.findall(_PAGE.read_text())}
    return rows[what]


def test_a_change_must_fit_in_one_place():
    assert apply("a\nb\nc\n", " a\n+x\n b\n@@\n-c\n+d\n") == "a\nx\nb\nd\n"
    with pytest.raises(AssertionError, match="2 places"):
        apply("ab\na\na\n", " a\n+x\n")


@in_section("A drilling cycle")
def test_a_drilling_cycle(tree):
    """The new board is built with the cycle, and a program with G81 drills where it should.

    The page's table says how many files one writes, and how many `make docs` renews.
    """
    assert (len(tree.written), 0) == file_counts_on_page("a drilling cycle")
    output = tree.python("-m", "pytest", "-q", "-p", "no:cacheprovider", "test_drill.py")
    assert re.search(r"^(=+ )?2 passed", output, re.MULTILINE), output
    built = tree.ugrbl("build --board drilling_mill.py")
    assert "extras/cycles.mpy" in built
    program = tree.folder / "holes.nc"
    program.write_text("G54 G10 L2 P1 Z1\nG0 Z5\nG81 X10 Y5 Z-2 R1 F100\nX20\nG80\n")
    line = (str(program), "--board", "drilling_mill.py", "--json", str(tree.folder / "j"))
    output = tree.python("-m", "ugrbl.cli", "run", *line)
    result = json.loads((tree.folder / "j").read_text())
    assert result["errors"] == [], output
    # Z0 of the work is at 1 mm of the machine: drilled to Z-2, begun at Z5.
    assert result["bounds_mm"]["Z"] == [-1.0, 6.0]
    assert result["bounds_mm"]["X"] == [0.0, 20.0]
    assert result["final_position_mm"] == {"X": 20.0, "Y": 5.0, "Z": 6.0}


@pytest.mark.sampled(1)
@in_section("A setting")
def test_a_setting(tree):
    """The new $99 is in the reference, and has a test of its effect.

    The page's table says how many files one writes, and how many `make docs` renews.
    """
    renewed_pages = tree.make_docs()
    assert "`$99`" in (tree.folder / "docs" / "reference.md").read_text()
    assert (len(tree.written), len(renewed_pages)) == file_counts_on_page("a setting")
    # Two tests: that each setting has an effect to observe, and that of the new $99.
    tests = ("-k", "99 or every_setting", "host_tests/whole/test_settings_effects.py")
    output = tree.python("-m", "pytest", "-q", "-p", "no:cacheprovider", "--all", *tests)
    assert re.search(r"^(=+ )?2 passed", output, re.MULTILINE), output


@in_section("A setting")
def test_a_setting_has_its_unit_in_grbl_09(tree):
    """Grbl 0.9 writes what a setting is after its value. other_output: pairs (line number,
    text)."""
    program = tree.folder / "ask.nc"
    program.write_text("$$\n")
    tree.python(
        *("-m", "ugrbl.cli", "run", str(program)),
        *("--board", "sim_09j", "--json", str(tree.folder / "told")),
    )
    lines = json.loads((tree.folder / "told").read_text())["other_output"]
    assert "$99=0.000 (seconds)" in [text for _, text in lines]


@in_section("A board")
def test_a_board(tree):
    """The new board is in the documents, can be built, and runs a program.

    The page's table says how many files one writes, and how many `make docs` renews.
    """
    renewed_pages = tree.make_docs()
    assert "`pen_plotter.py`" in (tree.folder / "docs" / "boards.md").read_text()
    assert (len(tree.written), len(renewed_pages)) == file_counts_on_page("a board")
    assert "board.py" in tree.ugrbl("build --board pen_plotter")
    tree.ugrbl("run examples/badge.nc --board pen_plotter --check")


_TALK = """
import sys
sys.path[:0] = ["firmware", "tools/sim/standins"]
import machine

class UART:
    def __init__(self, number, baudrate, tx, rx, rxbuf):
        self.arrived, self.sent = b"G0X1", b""

    def any(self):
        return len(self.arrived)

    def readinto(self, buf):
        count = min(len(buf), len(self.arrived))
        buf[:count], self.arrived = self.arrived[:count], self.arrived[count:]
        return count

    def read(self, most):
        read, self.arrived = self.arrived[:most], self.arrived[most:]
        return read

    def write(self, data):
        self.sent += bytes(data)

machine.UART = UART
from boot import parts
link = parts._link("serial")
buf = bytearray(3)
print(link.read_into(buf), bytes(buf), link.shared[0], link.read_into(buf), link.read_into(buf))
link.write(b"ok")
print(link._uart.sent)
link._uart.arrived = b"G1X2"
link.discard()
print(link.read_into(buf))
"""


@in_section("A link")
def test_a_link(tree):
    """A board with LINK = "serial" gets the new link's module instead of USB's, and it works.

    The page's table says how many files one writes, and how many `make docs` renews.
    """
    renewed_pages = tree.make_docs()
    assert (len(tree.written), len(renewed_pages)) == file_counts_on_page("a link")
    pico = (tree.folder / "boards" / "rpi_pico.py").read_text()
    board = tree.folder / "my_bluetooth.py"
    board.write_text(pico.replace('LINK = "usb"', 'LINK = "serial"'))
    tree.ugrbl("build --board my_bluetooth.py")
    ports = {file.name for file in (tree.folder / "build" / "my_bluetooth").rglob("*.mpy")}
    assert "serial_link.mpy" in ports and "usb_link.mpy" not in ports
    # _TALK prints what the new link reads of "G0X1" into a buffer of 3: 3 bytes, then 1, then 0;
    # the counter of arrivals (1) in between; what it writes; and 0 bytes left after discard().
    assert tree.python("-c", _TALK).splitlines() == ["3 b'G0X' 1 1 0", "b'ok'", "0"]


@in_section("An extra")
def test_an_extra(tree):
    """The page's example has M100 P1 and P0 switch a vacuum: a program with them has no errors."""
    assert (len(tree.written), 0) == file_counts_on_page("an extra")
    built = tree.ugrbl("build --board router.py")
    assert "vacuum.py" in built and "extras/api.mpy" in built
    program = tree.folder / "job.nc"
    program.write_text("M100 P1\nG1 X5 F300\nM100 P0\n")
    tree.python(
        *("-m", "ugrbl.cli", "run", str(program)),
        *("--board", "router.py", "--json", str(tree.folder / "told")),
    )
    assert json.loads((tree.folder / "told").read_text())["errors"] == []


@in_section("An extra")
def test_a_conflicting_pin_of_an_extra_is_named(tree):
    board = tree.folder / "router.py"
    board.write_text(board.read_text().replace("VACUUM = 20", "VACUUM = 8"))
    with pytest.raises(AssertionError, match="VACUUM"):
        tree.python("-m", "ugrbl.cli", "build", "--board", "router.py")


_DUST = """
from ugrbl.sim import Machine

with Machine("dusty_mill.py") as machine:

    def is_on():
        print(machine.outputs()["own_outputs"])

    is_on()
    machine.ask("M3 S500")
    is_on()
    machine.ask("M5")
    machine.run(2900)
    is_on()
    machine.run(300)
    is_on()
    machine.ask("M4 S9")
    is_on()
    machine.send(b"\\x18")
    machine.run(50)
    is_on()
    machine.program(["$X", "M3", "M30"])
    is_on()
    machine.run(3200)
    is_on()
"""


@in_section("A second output")
def test_a_second_output_follows_the_spindle(tree):
    """_DUST prints 1 while the output is on: at first; after M3; 2.9 and 3.2 s after M5; after M4;
    after a reset; after M3 and M30, and 3.2 s later."""
    assert (len(tree.written), 0) == file_counts_on_page("a second output")
    assert "dust.py" in tree.ugrbl("build --board dusty_mill.py")
    output = tree.python("-c", _DUST)
    assert output.split() == ["0", "1", "1", "0", "1", "0", "1", "0"]


_UNEVEN = """
from ugrbl.sim import Machine

with Machine("uneven_mill.py") as machine:
    for line in ("G21 G90", "G1 X20 F600", "G1 X30 Y10", "G1 Z-1"):
        machine.ask(line)
        machine.rest()
        print(*(steps / 250 for steps in machine.steps()))
"""


@in_section("A transform")
def test_a_transform_follows_the_grid(tree):
    """_UNEVEN moves the machine and prints X, Y and Z of the motors, in mm, after each line."""
    assert (len(tree.written), 0) == file_counts_on_page("a transform")
    # Heights in mm at points of a grid, a row of X per line of Y.
    (tree.folder / "heights.csv").write_text("0,1,2\n0,2,4\n0,0,0\n")
    tree.ugrbl("build --board uneven_mill.py")
    positions_mm = [
        [float(mm) for mm in line.split()] for line in tree.python("-c", _UNEVEN).splitlines()
    ]
    assert positions_mm == [
        [0, 0, 0],
        [20, 0, 1],
        [30, 10, 2.252],
        [30, 10, 1.252],
    ]  # exact to the step
