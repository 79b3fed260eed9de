"""UF2 files for a board: the boot ROM writes exactly the file's contents, and nothing else."""

import struct
from collections.abc import Mapping
from pathlib import Path
from random import Random

import pytest
import uf2_model
from hypothesis import given
from hypothesis import strategies as some
from ports.storage.flash_store import FlashStore
from typer.testing import CliRunner
from uf2_model import BASE
from ugrbl.cli.app import app
from ugrbl.compiling.build import Build
from ugrbl.image import binary_info, contents, file_system, uf2
from ugrbl.image.uf2 import PAGE, RP2040, RP2350, SECTOR, Flash, Uf2Error

littlefs = pytest.importorskip("littlefs")

_MIB = 1 << 20
_START, _SIZE = BASE + 0xA0000, 0x160000


def garbage(size: int, seed: int = 1) -> bytearray:
    return bytearray(Random(seed).randbytes(size))


def program(name: str = "MicroPython", version: str = "v1.28.0", devices: int = 1) -> Flash:
    """Return a MicroPython image that has only its binary info: name, version, block devices (file
    systems). The layout is that of pico-sdk's binary_info."""
    texts = {0x02031C86: name, 0x11A9BC3A: version}
    data_at, data, entries = BASE + 0x3000, b"", []
    for number, text in texts.items():
        entries.append(data_at + len(data))
        # type 6: an id and a string; 0x5052: tag RP
        data += struct.pack("<2H2I", 6, 0x5052, number, data_at + len(data) + 12)
        data += text.encode().ljust(32, b"\0")
    for _ in range(devices):
        entries.append(data_at + len(data))
        # type 7: a block device; 0x504D: tag MP
        data += struct.pack("<2H4IH2x", 7, 0x504D, 0, _START, _SIZE, 0, 0)
    # the header: markers around start, end and mapping of the entries
    head = b"\0" * 0x110 + struct.pack(
        "<5I", 0x7188EBF2, BASE + 0x2000, BASE + 0x2000 + 4 * len(entries), 0, 0xE71AA390
    )
    image = head.ljust(0x2000, b"\1") + struct.pack(f"<{len(entries)}I", *entries)
    image = image.ljust(0x3000, b"\2") + data
    pages = range(0, len(image), PAGE)
    return Flash(
        RP2040, {BASE + page: image[page : page + PAGE].ljust(PAGE, b"\3") for page in pages}
    )


# Blocks


@given(some.dictionaries(some.integers(0, 600), some.binary(min_size=PAGE, max_size=PAGE)))
def test_the_rom_writes_the_files_pages_and_touches_no_other_sector(
    pages: "dict[int, bytes]",
) -> None:
    """Pages of a touched sector that the file lacks are erased (0xFF)."""
    flash = Flash(RP2040, {BASE + PAGE * n: page for n, page in pages.items()})
    before = garbage(_MIB // 4)
    chip = bytearray(before)
    uf2_model.load(chip, uf2.write(flash))
    for sector in range(0, len(chip), SECTOR):
        numbers = range(sector // PAGE, (sector + SECTOR) // PAGE)
        wanted = b"".join(pages.get(number, b"\xff" * PAGE) for number in numbers)
        is_touched = any(number in pages for number in numbers)
        assert chip[sector : sector + SECTOR] == (
            wanted if is_touched else before[sector : sector + SECTOR]
        )


def test_a_file_appended_to_another_is_corrupted() -> None:
    """Why uf2.write() fills sectors: 20 pages end within a sector, the next ones are elsewhere,
    and the ROM corrupts some. uf2_model shows it."""
    pages = {BASE + PAGE * n: bytes([n]) * PAGE for n in (*range(20), *range(160, 176))}
    data = b"".join(  # without the magic numbers and flags, which uf2_model ignores
        struct.pack("<8I", 0, 0, 0, address, PAGE, number, len(pages), RP2040)
        + page.ljust(480, b"\0")
        for number, (address, page) in enumerate(pages.items())
    )
    chip = garbage(_MIB // 4)
    uf2_model.load(chip, data)
    assert any(chip[at - BASE : at - BASE + PAGE] != page for at, page in pages.items())


def test_a_written_file_is_read_back_even_after_blocks_of_others() -> None:
    """A block of another family at the beginning of a file is kept, and written first."""
    first = uf2.write(Flash(RP2350, {0x10FFFF00: b"\x11" * PAGE}))[:512]
    foreign = first[:28] + (0xE48BFF57).to_bytes(4, "little") + first[32:]
    flash = uf2.read(foreign + uf2.write(program()))
    assert flash.others == [foreign] and flash.family == RP2040
    assert uf2.write(flash)[:512] == foreign
    # the marker of the header
    assert flash.read(BASE + 0x110, 4) == (0x7188EBF2).to_bytes(4, "little")
    assert uf2.read(uf2.write(flash)) == flash


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "no UF2 file"),
        (b"x" * 511, "blocks of 512"),
        (b"x" * 1024, "block 0 is damaged"),
        (uf2.write(program())[:-4] + b"none", "is damaged"),
        (uf2.write(Flash(0xADA52840, {0: b"\0" * PAGE})), "not for one of RP2040 and RP2350"),
        (uf2.write(program()) + uf2.write(Flash(RP2350, program().pages)), "not for one of"),
    ],
)
def test_files_for_other_chips_or_damaged_files_are_reported(data: bytes, message: str) -> None:
    with pytest.raises(Uf2Error, match=message):
        uf2.read(data)


# Binary info


def test_micropython_reports_where_its_file_system_is() -> None:
    assert binary_info.about(program()) == ("MicroPython", "v1.28.0", _START, _SIZE)


@pytest.mark.parametrize(
    ("flash", "message"),
    [
        (Flash(RP2040), "no MicroPython"),
        (program(name="CircuitPython"), "no MicroPython"),
        (program(devices=0), "no MicroPython with a file system"),
    ],
)
def test_other_programs_are_reported(flash: Flash, message: str) -> None:
    with pytest.raises(Uf2Error, match=message):
        binary_info.about(flash)


def test_data_inside_the_file_system_is_reported() -> None:
    flash = program()
    flash.put(_START, bytes(SECTOR))
    with pytest.raises(Uf2Error, match="file system already has files"):
        binary_info.about(flash)


# The file system


def read_back(image: bytes) -> "dict[str, bytes]":
    """Return all files of an image."""
    context = littlefs.UserContext(len(image))
    context.buffer[:] = image
    disk = littlefs.LittleFS(
        context=context, block_size=SECTOR, block_count=len(image) // SECTOR, mount=True
    )
    files = {}
    for folder, _, names in disk.walk("/"):
        for name in names:
            path = f"{folder.rstrip('/')}/{name}"
            with disk.open(path, "rb") as file:
                files[path[1:]] = file.read()
    return files


def used_chip(size: int, seed: int) -> bytearray:
    """Return flash of this size (bytes) that was a file system in long use: each block has been
    written."""
    random = Random(seed)
    context = littlefs.UserContext(size)
    disk = littlefs.LittleFS(context=context, block_size=SECTOR, block_count=size // SECTOR)
    for k in range(400):
        folder = f"old{random.randrange(6)}"
        disk.makedirs(folder, exist_ok=True)
        with disk.open(f"{folder}/{random.randrange(4)}.py", "wb") as file:
            file.write(random.randbytes(random.randrange(9000)))
        if k % 7 == 0:
            disk.remove(f"{folder}/{disk.listdir(folder)[0]}")
    return bytearray(context.buffer)


def dragged_before(files: "Mapping[str, bytes]", size: int, random: Random) -> bytearray:
    """Return a file system that came from an earlier drag and was used since."""
    old = bytearray(size)
    overlay(old, files)
    context = littlefs.UserContext(size)
    context.buffer[:] = old
    disk = littlefs.LittleFS(context=context, block_size=SECTOR, block_count=size // SECTOR)
    for k in range(300):
        name = random.choice(sorted(files))
        with disk.open(name if k % 3 else name + str(k % 5), "wb") as file:
            file.write(random.randbytes(random.randrange(3000)))
    return bytearray(context.buffer)


def overlay(chip: bytearray, files: "Mapping[str, bytes]") -> None:
    """Write the generated file system over the chip, as a drag does."""
    for offset, sector in file_system.make(files, len(chip)).items():
        chip[offset : offset + SECTOR] = sector


@pytest.mark.parametrize("seed", range(6))
def test_an_older_file_system_is_replaced_completely(seed: int) -> None:
    """Over random bytes, a used file system, and one of an earlier drag."""
    random = Random(seed)
    files = {f"pack{n % 5}/module{n}.mpy": random.randbytes(200 * n) for n in range(25)}
    files["main.py"] = b"import main"
    size = 120 * SECTOR
    for old in (
        garbage(size, seed),
        used_chip(size, seed),
        dragged_before(files, size, random),
    ):
        overlay(old, files)
        assert read_back(bytes(old)) == files


@pytest.mark.parametrize("count", [1, 12, 40])
def test_root_folder_is_compacted(count: int) -> None:
    """A board reads the whole root folder for each name that it looks up."""
    files = {f"folder{n}/__init__.mpy": bytes([n]) * 3000 for n in range(count)}
    files["main.py"] = b"import main"
    chip = bytearray(_SIZE)
    overlay(chip, files)
    # the two blocks of the root folder: the one with the higher revision counts
    newer = max((chip[at : at + SECTOR] for at in (0, SECTOR)), key=lambda block: block[:4])
    assert len(newer.rstrip(b"\xff")) < 300 + 64 * count  # bytes up to the erased rest
    assert read_back(bytes(chip)) == files


def test_a_file_that_does_not_fit_is_named() -> None:
    with pytest.raises(Uf2Error, match=r"b\.py does not fit into the 40 KiB"):
        file_system.make({"a.py": bytes(9000), "b.py": bytes(40000)}, 10 * SECTOR)


# The whole file


def small_build(**files: bytes) -> Build:
    """Return a small build, with these files."""
    return Build("armv6m", {"main.py": b"main", "motion/__init__.mpy": b"M\6", **files}, "pio")


def after_a_drag(data: bytes) -> "tuple[bytes, Mapping[str, bytes]]":
    """Return the flash and the files in it after the file was dragged to a used board."""
    chip = used_chip(2 * _MIB, seed=3)
    uf2_model.load(chip, data)
    file_system_at = _START - BASE
    return bytes(chip), read_back(bytes(chip[file_system_at : file_system_at + _SIZE]))


def test_a_drag_leaves_micropython_and_the_files_of_a_deployment(tmp_path: Path) -> None:
    settings = tmp_path / "my.settings"
    settings.write_text("; mine\n$110=4321\n$32=1\n")
    flash = program()
    micropython_image = contents.MicroPython(
        tmp_path / "theirs.uf2", flash, binary_info.about(flash)
    )
    contents.check_fit(micropython_image, "armv6m", "pio")
    settings_files = contents.settings_files("rpi_pico", settings)
    files = contents.files(small_build(), {"custom.py": b"# mine", **settings_files})
    chip, files_on_board = after_a_drag(contents.join(micropython_image, files))
    assert all(chip[at - BASE : at - BASE + PAGE] == page for at, page in flash.pages.items())
    assert files_on_board == files and files_on_board["custom.py"] == b"# mine"
    assert files_on_board["deployed.sha256"].decode().splitlines()[0].endswith("  main.py")
    (tmp_path / "settings.txt").write_bytes(files_on_board["saved/settings.txt"])
    lines = FlashStore(f"{tmp_path}/").load("settings")  # as the firmware reads them
    assert lines and {"$110=4321", "$32=1", "$0=10"} <= set(lines)


@pytest.mark.parametrize(
    ("flash", "arch", "engine", "message"),
    [
        (program(), "armv7emsp", "pio", "is for RP2040; the board file is for RP2350"),
        (program(), "xtensawin", "rmt", "the board file is for ESP32"),
        (program(version="v1.22.2"), "armv6m", "pio", "1.22 is too old: .* needs 1.26"),
        (program(version=""), "armv6m", "pio", "contain its version number: put MicroPython"),
    ],
)
def test_a_micropython_for_another_board_is_reported(
    flash: Flash, arch: str, engine: str, message: str
) -> None:
    micropython_image = contents.MicroPython(Path("theirs.uf2"), flash, binary_info.about(flash))
    with pytest.raises(Uf2Error, match=message):
        contents.check_fit(micropython_image, arch, engine)


# The command


@pytest.fixture
def micropython(tmp_path: Path) -> Path:
    file = tmp_path / "RPI_PICO.uf2"
    file.write_bytes(uf2.write(program()))
    return file


def test_the_command_writes_the_file_and_says_where_to_drag_it(
    micropython: Path, tmp_path: Path
) -> None:
    out = tmp_path / "new" / "router.uf2"
    (tmp_path / "zero.settings").write_text("$111=0\n")
    settings = ("--settings", str(tmp_path / "zero.settings"))
    done = run("--micropython", str(micropython), "-o", str(out), *settings)
    assert done.exit_code == 0, done.output
    assert "drag the file onto RPI-RP2" in done.output and "v1.28.0, for RP2040" in done.output
    assert "note: $111=0 means a highest rate of 0 for Y" in done.output
    _, files_on_board = after_a_drag(out.read_bytes())
    assert {"main.py", "board.py", "deployed.sha256", "pio/engine.mpy"} <= files_on_board.keys()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--micropython nowhere.uf2", "nowhere.uf2: there is no such file"),
        ("--micropython bad.settings", "bad.settings: it is no UF2 file"),
        ("--micropython RPI_PICO.uf2 --settings nowhere", "nowhere cannot be read"),
        ("--micropython RPI_PICO.uf2 --settings more.settings", "the machine has no $999"),
        ("--micropython half.uf2", "it is cut off: 1 of its"),
        ("--micropython RPI_PICO.uf2 -o bad.settings", "must end in .uf2"),
        ("--micropython RPI_PICO.uf2 --settings bad.settings", "$0=1: error:6"),
        ("--micropython RPI_PICO.uf2 --custom bad.settings", "bad.settings is no Python file"),
        ("--micropython RPI_PICO.uf2 --custom bad.py", "no file was written"),
        ("--micropython RPI_PICO.uf2 -o RPI_PICO.uf2", "not overwritten"),
        ("--micropython RPI_PICO.uf2 -o bad.py/x.uf2", "bad.py"),
        ("--micropython RPI_PICO.uf2 --board rpi_pico2", "RPI_PICO.uf2: it is for RP2040"),
        ("--micropython RPI_PICO.uf2 --board toaster", "no board 'toaster'"),
    ],
)
def test_an_impossible_request_is_refused_in_one_sentence_and_writes_no_file(
    words: str, message: str, micropython: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """message: part of the output. half.uf2 has only the first of its blocks."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.settings").write_text("$0=1\n")
    (tmp_path / "more.settings").write_text("$110=500\n$999=1\n")
    (tmp_path / "half.uf2").write_bytes(micropython.read_bytes()[:512])
    (tmp_path / "bad.py").write_text("from ugrbl import mcode\n@mcode(3)\ndef f(m): pass\n")
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    done = run(*words.split())
    assert done.exit_code == 1 and message in done.output, done.output
    assert "Traceback" not in done.output and not isinstance(done.exception, KeyError)
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def run(*words: str):
    board = () if "--board" in words else ("--board", "rpi_pico")
    return CliRunner().invoke(app, ["uf2", *board, *words])
