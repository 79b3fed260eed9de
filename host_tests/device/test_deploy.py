"""Test `ugrbl build` and `ugrbl deploy`: the files of each board, and every failure.

A build holds the files for a board: modules compiled by mpy-cross (.mpy), main.py and board.py.
deploy() copies what has changed. LIST is a file on the board that names the deployed files with
their digests; files with other content are the user's and stay. main.py is removed first and
copied last, so that an incomplete deployment does not start."""

import ast
import contextlib
import errno
import gzip
import json
import os
import threading
import tty
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result
from ugrbl.boardfile import engines, files, page_files
from ugrbl.boardfile.files import BoardFileError, boards, load_board
from ugrbl.cli import deploy as deploy_cli
from ugrbl.cli import ports
from ugrbl.cli.app import app
from ugrbl.compiling import build
from ugrbl.compiling.folder import save
from ugrbl.compiling.inline import inline, pruned
from ugrbl.device.deploy import (
    LIST,
    About,
    DeployError,
    Running,
    check_fit,
    deploy,
    digest,
    signature,
)
from ugrbl.image import contents

# It builds firmware for boards: the first ring runs one test of each kind.
pytestmark = pytest.mark.thorough

REAL = [name for name in boards() if hasattr(load_board(name), "DIR")]
PICO = About(0x1306, "1.28.0", "Raspberry Pi Pico with RP2040")
# The endings that deploy_device.py looks for.
_LOOKED_AT = ("py", LIST, *page_files.names())
_MPY_START = b"M\x06\x00\x1f"  # start of a compiled file for any processor
SETTINGS = {
    "saved/settings.txt": b"$0=10",
    "saved/settings.old": b"$0=5",
    "saved/coords.new": b"",
    "log.txt": b"1",
}


def ugrbl(*words: object) -> Result:
    """Run the command; return its exit code and output."""
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def pico_build() -> build.Build:
    """Return the build for a Raspberry Pi Pico."""
    return build.for_board(files.board_file("rpi_pico"))


class FakeBoard:
    """A Device whose files are a dict. It logs every action."""

    def __init__(self, about: About = PICO, capacity_bytes: int = 1_000_000) -> None:
        self.disk: dict[str, bytes] = dict(SETTINGS)
        self.log: list[str] = []
        self.running = Running("Grbl 1.1h ['$' for help]", "1.1h.20261121:", 60_000)
        self._about = about
        self._capacity_bytes = capacity_bytes

    def enter(self) -> None:
        self.log.append("enter")

    def about(self) -> About:
        return self._about

    def files(self, folders: Iterable[str]) -> dict[str, str]:
        """Return the digests of files in these folders, as deploy_device.py finds them."""
        wanted = set(folders)
        return {
            path: digest(content)
            for path, content in self.disk.items()
            if path.rpartition("/")[0] in wanted and path.endswith(_LOOKED_AT)
        }

    def read(self, path: str) -> bytes:
        return self.disk[path]

    def write(self, path: str, content: bytes, progress: Callable[[int], None]) -> None:
        self.disk[path] = content
        self.log.append(f"write {path}")
        if sum(map(len, self.disk.values())) > self._capacity_bytes:
            raise OSError(errno.ENOSPC, path)
        progress(len(content))

    def remove(self, path: str) -> None:
        del self.disk[path]
        self.log.append(f"remove {path}")

    def make_folder(self, path: str) -> None:
        self.log.append(f"folder {path}")

    def restart(self) -> Running:
        self.log.append("restart")
        return self.running

    def close(self) -> None:
        pass

    def writes(self) -> list[str]:
        """Return the paths of the files written, in order."""
        return [line.removeprefix("write ") for line in self.log if line.startswith("write")]


class Silent:
    """A View that counts bytes."""

    def __init__(self) -> None:
        self.total = self.done = 0

    def begin(self, count: int, total: int) -> None:
        self.total = total

    def file(self, path: str) -> None:
        pass

    def written(self, count: int) -> None:
        self.done += count


def put(board: FakeBoard, to_deploy: build.Build, **options: Any) -> Any:
    """Deploy; return the result. The log begins anew."""
    board.log.clear()
    return deploy(board, to_deploy, Silent(), **options)


def with_changed_files(original: build.Build, *paths: str) -> build.Build:
    """Return the same build with these files changed or added."""
    changed_files = {path: _MPY_START + path.encode() for path in paths}
    return build.Build(original.arch, {**original.files, **changed_files})


# Files of a board


@pytest.fixture(scope="module")
def texts() -> "dict[str, str]":
    """Return the sources of all modules, with constants inlined."""
    return pruned(inline(build.texts()))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", REAL)
def test_board_gets_every_module_that_its_modules_import(
    name: str, texts: "dict[str, str]"
) -> None:
    """Only imports at top level: those inside functions may not be needed by the board."""
    modules_on_board = set(build.modules_of(load_board(name)))
    for each in modules_on_board:
        for node in ast.parse(texts[each]).body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                for module in build.imported(ast.unparse(node)):
                    assert module in modules_on_board or module not in texts, f"{each}: {module}"


def needed(**words: "str | bool") -> set[str]:
    """Return the sources that a Pico needs whose board file has these options."""
    board = load_board("rpi_pico")
    module = type(board)("made")
    vars(module).update({**vars(board), "CUSTOM": "", **words})
    return {f"{name.replace('.', '/')}.py" for name in build.modules_of(module)}


def test_board_gets_only_modules_that_it_can_use() -> None:
    """Each option adds its own modules to those of a plain Pico, and no others."""
    pico, i2s, rmt = needed(), needed(ENGINE="i2s", LINK="uart"), needed(ENGINE="rmt")
    assert {"main.py", "pio/pins.py", "ports/usb/usb_link.py", "pio/engine.py"} < pico
    assert not any(name.startswith(("esp", "ports/uart", "extras")) for name in pico)
    assert {"esp_chip/i2s.py", "esp_chip/frames.py", "ports/uart_link.py"} < i2s
    assert (
        not {
            "esp_chip/rmt.py",
            "esp_chip/trains.py",
            "ports/usb/usb_link.py",
            "pio/pins.py",
            "pio/engine_state.py",
            "pio/stack.py",
        }
        & i2s
    )
    assert {
        "esp_chip/rmt.py",
        "esp_chip/trains.py",
        "esp_chip/pins.py",
    } < rmt and "esp_chip/i2s.py" not in rmt
    # All extras need these.
    api = {"extras/api.py", "extras/cycles.py", "extras/custom_codes.py"}
    assert needed(TOOL="punch") - pico == {"extras/tools/punch.py", *api}
    custom = needed(CUSTOM="custom") - pico  # the default
    assert {"extras/custom/user_modules.py", "extras/custom/machine_api.py", *api} < custom
    assert {name for name in custom if not name.startswith("extras/")} == {"base/axes.py"}
    laser = needed(TOOL="laser") - pico
    assert laser == {
        *("extras/tools/laser.py", "motion/beam_layout.py", "pio/beam.py", "pio/beam_program.py"),
        *api,
    }
    clusters = {"extras/tools/clusters.py"}
    assert needed(TOOL="laser", CLUSTERS=True) - pico - laser == clusters
    jerk = {f"extras/motors/jerk{part}.py" for part in ("", "_kernel", "_plan")}
    assert needed(JERK=True) - pico - api == jerk
    jobs = needed(JOBS="jobs")
    assert needed(JOBS="jobs", SD_CARD=(10, 11, 12, 13)) - jobs == {
        "ports/storage/sd_blocks.py",
        "ports/storage/sd_card.py",
    }
    for pin in (0, 20):
        assert needed(POWER_FAIL=pin) - pico - api == {
            *("extras/power_fail.py", "ports/power_input.py", "ports/storage/prepared_page.py"),
            "base/axes.py",
        }
    assert needed(DIALECT="0.9") - pico == {"extras/dialects/dialect_09.py", *api}


def test_every_choice_is_an_existing_module_and_used_by_some_board() -> None:
    """All options at once, with each engine, link and tool: every module is needed by one of
    these boards, except modules that none imports."""
    assert {*build._SWITCHED, *build._CREATORS} <= {build.module(one) for one in build.sources()}
    used: set[str] = set()
    for engine in engines.engines():
        for link in engines.links():
            for tool in ("punch", "laser"):
                options = {"TOOL": tool, "DIALECT": "0.9", "COREXY": True, "CLUSTERS": True}
                options |= {"JERK": True, "CUSTOM": "custom", "LENIENT": True, "JOBS": "jobs"}
                options |= {"SD_CARD": (10, 11, 12, 13), "MOTORS": "XYZZ", "HOMING": ("XY",)}
                options |= {"ROTARY": "A", "TMC2209": (0, 2, 1), "BACKLASH": True}
                options |= {"KINEMATICS": "scara", "LIMIT": (9, 9, 11), "SKEW": True, "PAGE": True}
                options |= {"POWER_FAIL": 20}
                used |= needed(ENGINE=engine, LINK=link, **options)
    unused = {build.module(source) for source in set(build.sources()) - used}
    trees = [ast.parse(text) for text in pruned(inline(build.texts())).values()]
    assert not any(unused.intersection(build._imported(tree, ())) for tree in trees)
    # It has only constants, which are inlined.
    assert "pio.state_layout" in unused


def test_main_and_board_file_are_not_compiled(pico_build: build.Build) -> None:
    assert pico_build.files["main.py"] == (build.paths.FIRMWARE / "main.py").read_bytes()
    assert pico_build.files["board.py"] == files.board_file("rpi_pico").read_bytes()
    others = set(pico_build.files) - {"main.py", "board.py"}
    assert all(name.endswith(".mpy") for name in others)
    # The .mpy version is in the low byte, the processor from bit 10 on: 4 is armv6m.
    assert signature(pico_build) & 0xFF == 6 and signature(pico_build) >> 10 == 4


# The command build


def test_build_shows_bytes_and_writes_files(tmp_path: Path) -> None:
    done = ugrbl("build", "--board", "rpi_pico", "-o", tmp_path, "--json", tmp_path / "sizes")
    assert done.exit_code == 0, done.output
    sizes = json.loads((tmp_path / "sizes").read_text())
    assert sizes["arch"] == "armv6m" and sizes["bytes"] == sum(sizes["files"].values())
    for name, size in sizes["files"].items():
        assert (tmp_path / name).stat().st_size == size
        assert f"{size:7} {name}" in done.output


def test_build_without_a_board_compiles_everything(tmp_path: Path) -> None:
    done = ugrbl("build", "--arch", "xtensawin", "-o", tmp_path)
    assert done.exit_code == 0, done.output
    for source in build.sources():
        assert f" {source}" in done.output.replace(".mpy", ".py")


@pytest.mark.parametrize("options", [(), ("--frozen",)])
def test_build_writes_over_no_files_of_others(tmp_path: Path, options: "tuple[str, ...]") -> None:
    """The folder has files that no build has written."""
    (tmp_path / "main.py").write_text("# mine")
    (tmp_path / "mine.mpy").write_bytes(b"M")
    done = ugrbl("build", "--board", "rpi_pico", "--out", tmp_path, *options)
    assert done.exit_code == 1 and "has other files" in done.output.replace("\n", " ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["main.py", "mine.mpy"]
    assert (tmp_path / "main.py").read_text() == "# mine"


def test_files_of_an_earlier_build_are_removed(tmp_path: Path) -> None:
    """A .mpy file in a folder of the build is removed; a .py file of the user stays."""
    ugrbl("build", "--board", "rpi_pico", "-o", tmp_path)
    earlier_module, user_file = tmp_path / "pio" / "gone.mpy", tmp_path / "mine.py"
    earlier_module.write_bytes(b"M")
    user_file.write_bytes(b"")
    ugrbl("build", "--board", "rpi_pico", "-o", tmp_path)
    assert (
        not earlier_module.exists()
        and user_file.exists()
        and (tmp_path / "language/words.mpy").exists()
    )


def board_file(folder: Path, more: str, name: str = "mine") -> Path:
    """Write a Pico's board file with these lines added; return its path."""
    file = folder / f"{name}.py"
    file.write_text(files.board_file("rpi_pico").read_text() + more)
    return file


@pytest.mark.parametrize("command", ["build", "deploy"])
def test_punch_without_pins_is_refused(tmp_path: Path, command: str) -> None:
    done = ugrbl(command, "--board", board_file(tmp_path, 'TOOL = "punch"\nPUNCH_UP = 20\n'))
    assert done.exit_code == 1
    missing = "PUNCH_DOWN, PUNCH_DOWN_SENSOR, PUNCH_UP_SENSOR"
    assert f"mine.py: TOOL = punch: the board file names no pin for {missing}" in done.output


def test_every_problem_has_a_line_and_nothing_is_built(tmp_path: Path) -> None:
    """A board file with four mistakes."""
    more = "PROBE = 3\nSPINDLE_PWM = 24\nPWM_MAX = 65535\nDEFAULTS = {0: 1}\n"
    done = ugrbl("build", "--board", board_file(tmp_path, more), "-o", tmp_path / "out")
    assert done.exit_code == 1
    lines = done.output.strip().splitlines()
    for number, start in enumerate(
        (
            "mine.py: PROBE: pin 3 is STEP already",
            "mine.py: SPINDLE_PWM: Raspberry Pi Pico has no pin 24",
            "mine.py: PWM_MAX is 65535: it is 16383 at the most",
            "mine.py: DEFAULTS: $0=1 is refused",
        )
    ):
        assert lines[number].startswith(start)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("STEP = (2, 3", "is no Python file"),
        ("STEP = nothing", "fails: NameError"),
        ('ENGINE = "sim"', "is a machine of the simulator"),
        ('MPY_ARCH = "armv6m"', "ENGINE is missing"),
    ],
)
def test_file_that_is_not_a_board_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "mine.py").write_text(text)
    with pytest.raises(BoardFileError, match=said):
        build.for_board(files.board_file(str(tmp_path / "mine.py")))


def test_board_file_that_imports_another_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BoardFileError, match=r"imports boards\.sim, but"):
        files.load_for_build(board_file(tmp_path, "from boards.sim import RX_BYTES\n"))


def test_unknown_board_name_is_answered_with_the_known_ones() -> None:
    """Also: an output folder that is a file, and a board file that does not exist."""
    file = Path(__file__)
    done = ugrbl("build", "--board", "rpi_pico", "-o", file)
    assert done.exit_code == 1 and "is no folder" in done.output.replace("\n", " ")
    done = ugrbl("build", "--board", "potato")
    assert done.exit_code == 1 and "no board 'potato'; there are" in done.output
    assert "there is no file nowhere.py" in ugrbl("build", "--board", "nowhere.py").output


# Copied files


def test_new_board_gets_all_files_and_main_last(pico_build: build.Build) -> None:
    """view.total: bytes announced; view.done: bytes written."""
    board, view = FakeBoard(), Silent()
    result = deploy(board, pico_build, view)
    assert sorted(result.copied) == sorted(pico_build.files) and result.removed == []
    assert {path: board.disk[path] for path in pico_build.files} == pico_build.files
    assert board.writes()[-1] == "main.py" and board.log[-1] == "restart"
    assert board.log.index("folder pio") < board.log.index("write pio/engine.mpy")
    assert result.bytes == pico_build.bytes == view.total == view.done
    assert result.free_bytes == 60_000 and result.build == "1.1h.20261121:"


def test_up_to_date_board_is_only_started(pico_build: build.Build) -> None:
    """The second deployment of the same build."""
    board = FakeBoard()
    put(board, pico_build)
    result = put(board, pico_build)
    assert board.log == ["enter", "restart"]
    assert (result.copied, result.removed, result.unchanged) == ([], [], len(pico_build.files))


def test_only_changed_files_are_copied_and_main_is_removed_meanwhile(
    pico_build: build.Build,
) -> None:
    board = FakeBoard()
    put(board, pico_build)
    result = put(board, with_changed_files(pico_build, "language/words.mpy"))
    # with_changed_files() writes _MPY_START and the path, which has 18 characters.
    assert result.copied == ["language/words.mpy"] and result.bytes == len(_MPY_START) + 18
    assert board.log == [
        *("enter", "remove main.py", "folder language", "write language/words.mpy"),
        *(f"write {LIST}", "write main.py", "restart"),
    ]


def test_settings_and_user_files_stay(pico_build: build.Build) -> None:
    """Deploy twice on a board with stored settings and files of the user."""
    board = FakeBoard()
    user_files = {"lib/mine.py": b"1", "my_tool.py": b"2", "boot.py": b"3"}
    board.disk.update(user_files)
    put(board, pico_build)
    put(board, with_changed_files(pico_build, "language/words.mpy"))
    assert {**SETTINGS, **user_files}.items() <= board.disk.items()


def test_sources_that_would_hide_compiled_files_are_removed(pico_build: build.Build) -> None:
    """`mpremote cp -r firmware/. :/` leaves such sources; MicroPython imports a .py rather than
    the .mpy of the same name."""
    board = FakeBoard()
    for source in build.sources():
        board.disk[source] = (build.paths.FIRMWARE / source).read_bytes()
    result = put(board, pico_build)
    assert set(result.removed) == set(build.sources()) - {"main.py"}
    assert set(board.disk) == {*pico_build.files, *SETTINGS, LIST}


def test_package_file_of_another_board_is_removed(pico_build: build.Build) -> None:
    """A Pico has no modules of an ESP32."""
    board = FakeBoard()
    board.disk["esp_chip/__init__.mpy"] = b"M"
    assert put(board, pico_build).removed == ["esp_chip/__init__.mpy"]


def test_kernels_of_another_board_are_removed_without_a_list(pico_build: build.Build) -> None:
    """All files in the folder kernels are ours, even if LIST is missing."""
    board = FakeBoard()
    others = ["kernels/__init__.mpy", "kernels/extras_motors_jerk_kernel.mpy"]
    board.disk.update(dict.fromkeys(others, b"M"))
    assert put(board, pico_build).removed == others


def test_files_of_another_board_are_removed(pico_build: build.Build) -> None:
    board = FakeBoard()
    put(board, with_changed_files(pico_build, "esp_chip/rmt.mpy", "extras/tools/punch.mpy"))
    assert put(board, pico_build).removed == ["esp_chip/rmt.mpy", "extras/tools/punch.mpy"]


def test_module_of_older_firmware_is_removed_unless_it_was_changed(
    pico_build: build.Build,
) -> None:
    """Both were deployed before, and are not in the new build; the content of one is not ours
    any more."""
    board = FakeBoard()
    put(board, with_changed_files(pico_build, "once.mpy", "twice.mpy"))
    board.disk["twice.mpy"] = b"mine now"
    assert put(board, pico_build).removed == ["once.mpy"]
    assert board.disk["twice.mpy"] == b"mine now"


def test_unreadable_list_removes_nothing(pico_build: build.Build) -> None:
    board = FakeBoard()
    board.disk.update({LIST: b"\xff rubbish\n\n", "mine.py": b""})
    assert put(board, pico_build).removed == []


# The page


PICO2_W = About(0x1F06, "1.28.0", "Raspberry Pi Pico 2 W with RP2350")


@pytest.fixture(scope="module")
def with_page() -> build.Build:
    return build.for_board(files.board_file("pico2_w_page"))


def test_only_a_board_that_serves_the_page_has_its_files(
    pico_build: build.Build, with_page: build.Build
) -> None:
    page = page_files.made()
    assert page.items() <= with_page.files.items() and not page.keys() & pico_build.files.keys()
    assert page["page.gz"] == page_files.made()["page.gz"], "the same each time"
    assert gzip.decompress(page["page.gz"]) == page_files.page(from_board=True).encode()
    assert {"ports/net/page.mpy", "ports/net/web_socket.mpy"} <= {*with_page.files}


def test_changed_page_is_updated_and_removed_when_not_served(
    with_page: build.Build, tmp_path: Path
) -> None:
    """Three deployments: with the page, with the page changed on the board, without the page."""
    file = tmp_path / "board.py"
    text = files.board_file("pico2_w_page").read_text()
    file.write_text(text.replace("PAGE = True", ""))
    build_without_page = build.for_board(file)
    board = FakeBoard(PICO2_W)
    put(board, with_page)
    assert {*page_files.names()} <= set(board.disk)
    board.disk["page.gz"] = b"older"
    put(board, with_page)
    assert board.writes() == ["page.gz", LIST, "main.py"]
    files_of_page = {*with_page.files} - {*build_without_page.files}
    assert {*put(board, build_without_page).removed} == files_of_page > {*page_files.names()}


def test_page_is_copied_next_to_frozen_firmware(with_page: build.Build) -> None:
    """The modules are in the image of MicroPython (frozen): only the files that cannot be are
    copied."""
    frozen = with_page.id
    board = FakeBoard(PICO2_W._replace(frozen=frozen))
    put(board, with_page)
    assert board.writes() == ["board.py", *sorted(page_files.names()), LIST]


def test_uf2_file_contains_the_page(with_page: build.Build) -> None:
    """With all modules as files, and with the modules frozen into the image."""
    all_files = contents.files(with_page, {})
    assert page_files.made().items() <= all_files.items()
    frozen = with_page.id
    files_next_to_frozen = contents.files(with_page, {}, frozen)
    assert {*files_next_to_frozen} == {"board.py", LIST, *page_files.names()}


# The board's own board.py


def test_board_file_changed_on_the_board_is_not_lost(pico_build: build.Build) -> None:
    """The user has edited board.py there: it is replaced only on request."""
    board = FakeBoard()
    put(board, pico_build)
    board.disk["board.py"] += b"PROBE = 28\n"
    with pytest.raises(DeployError, match="changed there since") as refused:
        put(board, pico_build)
    assert "--replace" in refused.value.todo and board.log == ["enter"]
    assert put(board, pico_build, replace=True).copied == ["board.py"]


def test_foreign_main_is_not_lost(pico_build: build.Build) -> None:
    """A main.py that deploy has not written is replaced only on request (--replace)."""
    board = FakeBoard()
    board.disk["main.py"] = b"print('blink')"
    with pytest.raises(DeployError, match=r"main\.py was not put on the board"):
        put(board, pico_build)
    assert board.disk["main.py"] == b"print('blink')"
    put(board, pico_build, replace=True)
    assert board.disk["main.py"] == pico_build.files["main.py"]


def test_deployed_board_file_is_replaced_by_another(
    pico_build: build.Build,
) -> None:
    board = FakeBoard()
    put(board, pico_build)
    assert put(board, with_changed_files(pico_build, "board.py")).copied == ["board.py"]


# Failures


@pytest.mark.parametrize(
    ("about", "said", "todo"),
    [
        (PICO._replace(mpy=0x1F06), "armv7emsp \\(RP2350\\); the board file is for", "--board"),
        (PICO._replace(mpy=0x2B06), "xtensawin \\(ESP32 or ESP32S3\\)", "--board"),
        (PICO._replace(mpy=0x1206), "version 6.2, and mpy-cross makes 6.3", "MicroPython 1.28"),
        (PICO._replace(mpy=0x1305), "version 5.3, and mpy-cross makes 6.3", "MicroPython 1.28"),
        (PICO._replace(mpy=0), "cannot load compiled files", "official MicroPython"),
    ],
)
def test_board_that_cannot_run_the_build_is_not_touched(
    pico_build: build.Build, about: About, said: str, todo: str
) -> None:
    """mpy: what the board reports of the compiled files it loads: version in the low bits,
    processor from bit 10 on."""
    board = FakeBoard(about)
    with pytest.raises(DeployError, match=said) as refused:
        put(board, pico_build)
    assert todo in refused.value.todo
    assert board.log == ["enter"] and board.disk == SETTINGS


def test_matching_board_is_accepted(pico_build: build.Build) -> None:
    check_fit(PICO, pico_build)


def test_old_micropython_is_refused_before_anything_is_copied(
    pico_build: build.Build,
) -> None:
    """The check at the end accepts the oldest version that is new enough."""
    board = FakeBoard(PICO._replace(version="1.25.0"))
    why = "MicroPython 1.25 is too old: ENGINE pio on RP2040 needs 1.26 or newer, for hard timer"
    with pytest.raises(DeployError, match=why) as refused:
        put(board, pico_build)
    assert "1.28" in refused.value.todo
    assert board.disk == SETTINGS and "restart" not in board.log
    check_fit(PICO._replace(version="1.26.0"), pico_build)


def test_full_board_is_reported_and_not_started(pico_build: build.Build) -> None:
    """The flash has space for half of the build."""
    board = FakeBoard(capacity_bytes=pico_build.bytes // 2)
    with pytest.raises(DeployError, match=r"flash is full, at \w+") as refused:
        put(board, pico_build)
    assert "remove what you do not need" in refused.value.todo
    assert "main.py" not in board.disk and "restart" not in board.log


def test_incomplete_deployment_is_completed(pico_build: build.Build) -> None:
    """The first one ends because flash is full; then there is space."""
    board = FakeBoard(capacity_bytes=pico_build.bytes // 2)
    with pytest.raises(DeployError):
        put(board, pico_build)
    board._capacity_bytes = 1_000_000
    put(board, pico_build)
    assert {path: board.disk[path] for path in pico_build.files} == pico_build.files


# The command deploy


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch, pico_build: build.Build) -> FakeBoard:
    """Let `ugrbl deploy` find this board, and use a finished build."""
    from ugrbl.device import deploy_device

    board = FakeBoard()
    monkeypatch.setattr(deploy_device, "MpremoteDevice", lambda port: board)
    monkeypatch.setattr(build, "for_board", lambda file: pico_build)
    monkeypatch.setattr(ports, "choose", lambda port: port or "/dev/ttyACM7")
    return board


def test_deploy_reports_what_it_has_done(plugged: FakeBoard) -> None:
    output = " ".join(ugrbl("deploy", "--board", "rpi_pico").output.replace("│", " ").split())
    for part in ("at /dev/ttyACM7", "Grbl 1.1h ['$' for help]", "1.1h.20261121", "60000 bytes"):
        assert part in output
    second_output = " ".join(ugrbl("deploy", "--board", "rpi_pico").output.split())
    assert "copied │ 0 files, 0 bytes" in second_output


def test_deploy_is_reported_as_json(plugged: FakeBoard) -> None:
    done = ugrbl("deploy", "--board", "rpi_pico", "--port", "COM3", "--json", "-")
    result = json.loads(done.stdout)
    assert (result["board"], result["port"], result["free_bytes"]) == ("rpi_pico", "COM3", 60_000)
    assert "language/words.mpy" in result["copied"] and result["unchanged"] == 0


def test_failure_is_reported_as_json(plugged: FakeBoard) -> None:
    plugged._about = PICO._replace(mpy=0x1F06)  # an RP2350, not the RP2040 of the build
    done = ugrbl("deploy", "--board", "rpi_pico", "--json", "-")
    assert done.exit_code == 1
    result = json.loads(done.stdout)
    assert "RP2350" in result["problems"][0] and "--board" in result["todo"]
    assert "RP2350" in done.stderr and "->" in done.stderr


def test_ctrl_c_reports_the_state_it_leaves(
    plugged: FakeBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C arrives while the first file is written."""

    def interrupt(*words: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(plugged, "write", interrupt)
    done = ugrbl("deploy", "--board", "rpi_pico")
    assert done.exit_code == 1 and "deploy again" in done.output


def test_missing_port_is_reported(tmp_path: Path) -> None:
    done = ugrbl("deploy", "--board", "rpi_pico", "--port", tmp_path / "nothing")
    assert done.exit_code == 1
    assert "no such port" in done.output and "-> is its name right" in done.output


def test_missing_board_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "find", list)
    done = ugrbl("deploy", "--board", "rpi_pico")
    assert done.exit_code == 1 and "no controller was found" in done.output


@pytest.mark.parametrize("command", ["build", "deploy"])
def test_help_has_examples(command: str) -> None:
    assert f"ugrbl {command} --board rpi_pico" in " ".join(ugrbl(command, "--help").output.split())
    assert deploy_cli.EXAMPLES


# Devices on the port


@pytest.fixture
def deploy_to_port(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Iterator[Callable[..., str]]:
    """Return a function that deploys to a port which answers bytes by a table, and returns the
    output.

    A value None closes the port."""
    from ugrbl.device import deploy_device

    for name in ("_STATUS_S", "_PROMPT_S", "_RAW_S"):
        monkeypatch.setattr(deploy_device, name, 0.3)  # seconds to wait for an answer
    master, slave = os.openpty()
    tty.setraw(slave)
    port = tmp_path / "port"
    port.symlink_to(os.ttyname(slave))
    table: dict[bytes, bytes | None] = {}

    def play() -> None:
        """Answer at the other end of the port until it is closed."""
        with contextlib.suppress(OSError):
            while data := os.read(master, 100):
                answer = table.get(data, b"")
                if answer is None:
                    break
                os.write(master, answer)
        os.close(master)

    def deploy_there(answers: Mapping[bytes, bytes | None]) -> str:
        """Add answers to the table, deploy, and return the output."""
        table.update(answers)
        threading.Thread(target=play, daemon=True).start()
        done = ugrbl("deploy", "--board", "rpi_pico", "--port", port)
        assert done.exit_code == 1
        return " ".join(done.output.split())

    yield deploy_there
    os.close(slave)  # ends the thread


def test_moving_machine_is_not_disturbed(deploy_to_port: Callable[..., str]) -> None:
    output = deploy_to_port({b"?": b"<Run|MPos:1.000,0.000,0.000|FS:100,0>\r\n"})
    assert "is in Run, and is not interrupted" in output


def test_held_machine_is_reported_with_the_remedy(deploy_to_port: Callable[..., str]) -> None:
    output = deploy_to_port({b"?": b"<Hold:0|MPos:1.000,0.000,0.000|FS:0,0>\r\n"})
    assert "is in Hold" in output
    assert "resume (~) or reset (Ctrl-X) it, then deploy again" in output


_IDLE: "dict[bytes, bytes | None]" = {b"?": b"<Idle|MPos:1.000,0.000,0.000|FS:0,0>\r\n"}


def test_simulator_is_reported(deploy_to_port: Callable[..., str]) -> None:
    assert "the simulator answers on" in deploy_to_port(_IDLE)


def test_other_grbl_is_reported(
    deploy_to_port: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ugrbl.device.deploy_device.is_simulator", lambda port: False)
    output = deploy_to_port(_IDLE)  # it ignores Ctrl-C
    assert "does not open MicroPython's prompt -> is it ugrbl?" in output


def test_silent_port_is_reported(deploy_to_port: Callable[..., str]) -> None:
    output = deploy_to_port({})
    assert "no MicroPython answers on" in output and "hold BOOTSEL" in output


def test_unplugged_cable_is_reported(deploy_to_port: Callable[..., str]) -> None:
    assert "the connection broke" in deploy_to_port({b"?": None})


# package.json


def test_package_json_lists_every_file_of_a_build_and_its_path(tmp_path: Path) -> None:
    """Each entry of urls: the path on the board, and the file next to package.json."""
    package = build.for_board(build.paths.BOARDS / "rpi_pico.py")
    save(package, tmp_path)
    listed = json.loads((tmp_path / "package.json").read_text())["urls"]
    assert {path for path, _ in listed} == set(package.files) and listed[-1][0] == "main.py"
    assert all((tmp_path / source).read_bytes() == package.files[path] for path, source in listed)
