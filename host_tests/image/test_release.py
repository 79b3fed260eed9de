"""Release files: everything that works without a network, and the names used for the images."""

import hashlib
import io
import json
import re
import zipfile
from pathlib import Path

import pytest
from ugrbl import __version__, paths
from ugrbl.boardfile import page_files
from ugrbl.boardfile.chips import BUILT_IN
from ugrbl.boardfile.files import board_file, load_board
from ugrbl.compiling import build, motion_package
from ugrbl.image import release

_ROOT = Path(__file__).parents[2]
_WORKFLOW = (_ROOT / ".github" / "workflows" / "release.yml").read_text()
# Modules that MicroPython 1.28 freezes for an ESP32 (ports/esp32/boards/manifest.py).
_FROZEN_ON_ESP32 = (
    *("_boot", "aioespnow", "apa106", "asyncio", "dht", "ds18x20", "espnow", "flashbdev"),
    *("inisetup", "mip", "neopixel", "ntptime", "onewire", "requests", "ssl", "umqtt", "upysh"),
    "webrepl",
)
_WIZARD = (paths.TOOLS / "web" / "page" / "board_wizard.js").read_text(encoding="utf-8")


def test_a_dry_run_makes_all_files_without_network(tmp_path: Path) -> None:
    """A version of "" is a dry run. SHA256SUMS has every file, also an image that was there
    before."""
    image = tmp_path / "ugrbl-dry-RPI_PICO.uf2"
    image.write_bytes(b"image")
    release.make("", tmp_path, ["rpi_pico", "esp32_devkit"])
    assert (tmp_path / "ugrbl.html").read_text(encoding="utf-8") == page_files.page()
    checksums = dict(
        reversed(row.split("  ")) for row in (tmp_path / "SHA256SUMS").read_text().splitlines()
    )
    zips = {f"ugrbl-dry-{name}.zip" for name in ("rpi_pico", "esp32_devkit")}
    zips |= {f"ugrbl_motion-dry-{arch}.zip" for arch in ("armv6m", "armv7emsp", "xtensawin")}
    assert set(checksums) == {image.name, "ugrbl.html", *zips}
    for name, checksum in checksums.items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == checksum
    assert (tmp_path / "notes" / "notes.md").read_text().startswith("### Added")


def test_a_board_zip_is_installable_by_mip_and_reproducible() -> None:
    """mip, MicroPython's installer, copies the files listed in package.json."""
    data = release.board_zip("rpi_pico")
    assert data == release.board_zip("rpi_pico")
    compiled = build.for_board(board_file("rpi_pico"))
    with zipfile.ZipFile(io.BytesIO(data)) as zip_file:
        listed = json.loads(zip_file.read("rpi_pico/package.json"))["urls"]
        assert {path for path, _ in listed} == set(compiled.files)
        assert {
            path: zip_file.read(f"rpi_pico/{path}") for path in compiled.files
        } == compiled.files


def test_the_motion_package_is_installable_by_mip_and_has_stubs() -> None:
    """mip, MicroPython's installer, copies the files listed in package.json; editors read the
    stubs."""
    compiled = motion_package.compile_for("armv6m")
    with zipfile.ZipFile(io.BytesIO(release.motion_zip("armv6m"))) as zip_file:
        listed = json.loads(zip_file.read("ugrbl_motion/package.json"))["urls"]
        assert {path for path, _ in listed} == set(compiled.files)
        assert {
            path: zip_file.read(f"ugrbl_motion/{path}") for path in compiled.files
        } == compiled.files
        assert "ugrbl_motion/typings/ugrbl_motion/group.pyi" in zip_file.namelist()


def test_a_tag_must_match_the_version_and_have_notes() -> None:
    newest = "# Changelog\n\n## [Unreleased]\n\n## [0.2.0] - 2027-01-01\n\n- New.\n"
    changelog = newest + "\n## [0.1.0]\n\n- Old.\n"
    assert release.notes(changelog, "v0.2.0") == "- New.\n"
    assert release.notes(changelog, "v0.1.0") == "- Old.\n"
    for tag in ("", "v0.3.0"):
        with pytest.raises(release.ReleaseError, match="has nothing under"):
            release.notes(changelog, tag)
    release.check_version(f"v{__version__}")
    with pytest.raises(release.ReleaseError, match="make them one"):
        release.check_version("v99.0")


def test_nothing_is_written_if_the_version_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(release.ReleaseError):
        release.make("v99.0", tmp_path, ["rpi_pico"])
    assert not list(tmp_path.iterdir())


def test_the_page_and_the_workflow_use_the_same_image_names() -> None:
    """The workflow builds the images of a release; the wizard of the page names the one to
    download."""
    in_workflow = set(re.findall(r"board: (RPI_\w+)", _WORKFLOW))
    assert set(re.findall(r'"(RPI_\w+)"', _WIZARD)) == in_workflow
    assert "ugrbl-$GITHUB_REF_NAME-${{ matrix.board }}.uf2" in _WORKFLOW
    assert "ugrbl-…-${IMAGES[name]}.uf2" in _WIZARD
    for board in re.findall(r"file: (\w+)", _WORKFLOW):
        assert board_file(board).is_file()


def test_each_esp32_image_has_a_board_file_of_its_chip_and_is_documented() -> None:
    """rows: the images that the workflow builds, with board and variant of MicroPython."""
    rows = re.findall(
        r"\{board: (ESP32\w+),(?: variant: (\w+),)? image: (\S+), file: (\w+)\}", _WORKFLOW
    )
    documented = (_ROOT / "docs" / "boards.md").read_text(encoding="utf-8")
    assert len(rows) == 3
    for board, variant, image, file in rows:
        assert image == "-".join(filter(None, (board, variant)))
        chip = getattr(load_board(file), "CHIP", "esp32")
        assert chip == ("esp32s3" if board.endswith("_S3") else "esp32")
        assert f"`ugrbl-…-{image}.bin`" in documented
    assert "ugrbl-$GITHUB_REF_NAME-${{ matrix.image }}.bin" in _WORKFLOW


def test_no_frozen_package_hides_a_module_of_micropython() -> None:
    ours = {source.partition("/")[0].removesuffix(".py") for source in build.sources()}
    assert not ours & {*BUILT_IN, *_FROZEN_ON_ESP32}


def test_the_workflow_makes_the_same_files_as_the_dry_run() -> None:
    makefile = (_ROOT / "Makefile").read_text()
    assert "make release-files VERSION=$GITHUB_REF_NAME" in _WORKFLOW
    assert "--notes-file dist/notes/notes.md" in _WORKFLOW
    assert re.search(r"^release-dry: .*\n\t\$\(MAKE\) release-files", makefile, re.MULTILINE)
