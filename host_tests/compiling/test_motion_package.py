"""The package ugrbl_motion: its size, its modules, its stubs; and boards pay nothing for it."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from ugrbl import paths
from ugrbl.boardfile.chips import ARCHS
from ugrbl.boardfile.files import board_file, load_for_build
from ugrbl.compiling import build, motion_package
from ugrbl.compiling.build import LIBRARY
from ugrbl.device.deploy import signature
from ugrbl.run import stubs

_MOST_BYTES = 40_000
_LAYERS = {path.name for path in paths.FIRMWARE.iterdir() if path.is_dir()}


@pytest.mark.parametrize("arch", ["armv6m", "armv7emsp"])
def test_it_is_smaller_than_40_kb_on_a_pico(arch: str) -> None:
    package = motion_package.compile_for(arch)
    assert 30_000 < package.bytes < _MOST_BYTES
    # the number of the processor in each .mpy file
    assert signature(package) >> 10 == {"armv6m": 4, "armv7emsp": 7}[arch]


def test_the_page_has_its_sizes() -> None:
    """Sizes in docs/engine.md, one per processor, are within 1 %."""
    text = (paths.FIRMWARE.parent / "docs" / "engine.md").read_text(encoding="utf-8")
    stated = [int(number.replace(",", "")) for number in re.findall(r"\| ([\d,]+) bytes \|", text)]
    sizes = [motion_package.compile_for(arch).bytes for arch in ARCHS]
    for stated_bytes, actual_bytes in zip(stated, sizes, strict=True):
        assert stated_bytes == pytest.approx(actual_bytes, rel=0.01)


@pytest.mark.parametrize(("arch", "other"), [("armv6m", "rmt"), ("xtensawin", "pio")])
def test_everything_is_in_one_package_and_everything_imported_is_there(
    arch: str, other: str
) -> None:
    """other: the function of hardware.py that imports the engine of other chips."""
    package = motion_package.compile_for(arch)
    assert {path.split("/")[0] for path in package.files} == {LIBRARY}
    modules = {Path(path).stem for path in package.files}
    imported = set()
    for text in motion_package._in_one_package(arch).texts.values():
        for name in build.imported(text, frozenset({other})):
            top, _, inner = name.partition(".")
            assert top not in _LAYERS - {LIBRARY}, name
            if top == LIBRARY and inner:
                imported.add(inner.partition(".")[0])
    assert imported <= modules and len(imported) > 8


@pytest.mark.parametrize("arch", ARCHS)
def test_package_itself_has_all_names_that_it_exports(arch: str) -> None:
    """Its only assignment is __all__, and it imports exactly these names."""
    tree = ast.parse(motion_package._in_one_package(arch).texts[LIBRARY])
    (all_names,) = (node for node in tree.body if isinstance(node, ast.Assign))
    imports = (node for node in tree.body if isinstance(node, ast.ImportFrom))
    names = [alias.name for node in imports for alias in node.names]
    assert sorted(names) == sorted(ast.literal_eval(all_names.value)) != []


def test_each_chip_gets_its_own_engine() -> None:
    """Modules of the PIO engine are for a Pico (armv6m) only, those of RMT for an ESP32
    (xtensawin)."""
    stems = {
        arch: {Path(path).stem for path in motion_package.compile_for(arch).files}
        for arch in ("armv6m", "xtensawin")
    }
    assert {"engine", "programs"} <= stems["armv6m"] and "rmt" not in stems["armv6m"]
    assert {"rmt", "trains"} <= stems["xtensawin"] and "programs" not in stems["xtensawin"]


def test_nothing_of_the_g_code_machine_is_in_it() -> None:
    stems = {Path(path).stem for path in motion_package.compile_for("armv6m").files}
    of_the_machine = {
        Path(source).stem
        for source in build.sources()
        if source.split("/")[0] in ("control", "language", "talk", "extras", "boot", "ports")
    }
    assert not stems & of_the_machine
    assert not stems & {"settings", "state", "arc_geometry", "errors"}


def test_boards_pay_nothing_for_it() -> None:
    """A board's build has no module of the package."""
    assert not [source for source in build.sources() if source.startswith(LIBRARY)]
    for name in ("rpi_pico", "esp32_devkit"):
        modules = build.modules_of(load_for_build(board_file(name)))
        assert modules and not [module for module in modules if LIBRARY in module]


def test_its_modules_are_those_of_the_firmware() -> None:
    """The package adds a wiring of its own (firmware/ugrbl_motion); all other modules are the
    firmware's."""
    own_modules = {name.partition(".")[2] or "__init__" for name in motion_package.texts()}
    firmware_modules = {Path(source).stem for source in build.sources()}
    texts = motion_package._in_one_package("xtensawin").texts
    stems = {name.partition(".")[2] or "__init__" for name in texts}
    assert stems - own_modules <= firmware_modules and not own_modules & firmware_modules


# Stubs

WRONG = {
    "x.mov(1)": "mov",
    "group.move(speed='fast', x=1)": "arg-type",
    "x.position = 3": "read-only",
    "Axis(2, 5, 80, 100)": "acceleration",
    "group.moved(3) + 1": "operand",
}


def run_mypy(folder: Path, *files: Path) -> str:
    """Check files with mypy against the stubs in a folder only; return its output."""
    options = ["--strict", "--no-incremental", "--cache-dir", str(folder / "cache")]
    process = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", "", *options, *map(str, files)],
        env={"MYPYPATH": str(folder / stubs.FOLDER), "PATH": ""},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    return process.stdout + process.stderr


def write_stubs(folder: Path) -> None:
    """Write the stubs of ugrbl_motion and of custom modules to a folder."""
    for path, text in {**stubs.motion(), **stubs.custom()}.items():
        paths.write(folder / path, text.encode())


def test_stubs_fit_the_examples_and_find_mistakes(tmp_path: Path) -> None:
    write_stubs(tmp_path)
    head = "from ugrbl_motion import Axis, Group\nx = Axis(2, 5, 80, 100, 500)\n"
    wrong = tmp_path / "wrong.py"
    wrong.write_text(head + "group = Group(x=x)\n" + "\n".join(WRONG) + "\n")
    examples = sorted((paths.EXAMPLES / "motion").glob("*.py"))
    assert "Success" in run_mypy(tmp_path, *examples)
    errors = run_mypy(tmp_path, wrong).splitlines()
    for number, text in enumerate(WRONG.values(), 4):  # the mistakes of WRONG begin in line 4
        assert [row for row in errors if f":{number}: error" in row and text in row], (
            number,
            errors,
        )


CUSTOM = """
from ugrbl import Machine, Refuse, every, gcode, mcode, on

@mcode(100, "Pq")
def vacuum(m: Machine, P: float, Q: float = 0) -> None:
    if P > 1:
        raise Refuse("P1 is on")
    m.out("vacuum", P)
    with m.saved():
        place = m.probe("G53 Z-42 F200", must=False)
        if place:
            m.set_work(place, "Z0")
    m.keep["count"] = m.keep.get("count", 0) + 1

@on.tool_change
def change(m: Machine, tool: int) -> None:
    m.ask("tool %d" % tool)

@on.input("door")
def door(m: Machine, closed: bool) -> None:
    m.hold()
"""


def test_stubs_of_custom_fit_programs_and_find_mistakes(tmp_path: Path) -> None:
    """wrong.py calls a method that does not exist, passes text for a time, and uses an unknown
    event."""
    write_stubs(tmp_path)
    right, wrong = tmp_path / "right.py", tmp_path / "wrong.py"
    right.write_text(CUSTOM)
    wrong.write_text(CUSTOM + "    m.houd()\n    m.wait('long')\non.lunch\n")
    assert "Success" in run_mypy(tmp_path, right)
    output = run_mypy(tmp_path, wrong)
    assert '"houd"' in output and "arg-type" in output and '"lunch"' in output


def test_stubs_have_all_that_the_pages_document() -> None:
    """Every public method of m is there, with its docstring; none of the firmware's."""
    (text,) = (text for path, text in stubs.custom().items() if path.endswith(".pyi"))
    page = (paths.FIRMWARE.parent / "docs" / "custom.md").read_text(encoding="utf-8")
    (machine,) = (
        node
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef) and node.name == "Machine"
    )
    methods = [node for node in machine.body if isinstance(node, ast.FunctionDef)]
    assert len(methods) > 20
    assert [node.name for node in methods if f"m.{node.name}" not in page] == ["__init__"]
    assert [node.name for node in methods if not ast.get_docstring(node)] == ["__init__"]
