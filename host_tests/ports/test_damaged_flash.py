"""Stored files are damaged in flash: the machine starts, uses the older copy, and reports it.

Each name is stored as NAME.txt with the copy before it as NAME.old; NAME.new exists only while a
file is written. The last line of a file is its checksum. Power cuts are not damage: see
test_flash_store.py. UGRBL_TORTURE starts a machine with every bit of every file flipped, and with
every file cut at every byte (flips=None); otherwise `flips` random bits are flipped and as many
cuts tried. Dice(n): random numbers."""

import os
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from byte_bench import (
    NAMES,
    Bench,
    Dice,
    damages,
    flash_files,
    start_damaged,
    start_with_damaged_custom,
    store_under_all_names,
    write_initial_files,
)
from micropython_runner import needs_micropython, run_micropython
from ports.storage.flash_store import FlashStore
from test_bytes import PATHS
from ugrbl.run.board_modules import complete

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)

_BENCH = Path(__file__).parents[1] / "support" / "byte_bench.py"
_EVERY = os.environ.get("UGRBL_TORTURE") is not None


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a machine that has stored something under each name, twice."""
    complete()  # MicroPython's functions of `time`
    here = Path.cwd()  # the machine changes it
    folder = tmp_path_factory.mktemp("damage") / "board"
    store_under_all_names(str(folder))
    os.chdir(here)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_a_machine_starts_with_the_older_copy_of_any_damaged_file(
    name: str, filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The machine is started once with each damage; start_damaged checks its values and
    reports."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "board"
    shutil.copytree(filled, folder)
    start_damaged(
        str(folder), flash_files(str(folder)), name, Dice(1), flips=None if _EVERY else 1
    )


@pytest.mark.parametrize("name", NAMES)
def test_damage_is_always_detected(name: str, filled: Path, tmp_path: Path) -> None:
    """Whatever is damaged in the newest file, the store returns the lines of the older copy and
    notes that one was there."""
    files = flash_files(str(filled))
    newest, old = files[f"{name}.txt"], files[f"{name}.old"]
    (tmp_path / f"{name}.old").write_bytes(old)
    for damaged_file in damages(newest, Dice(2), flips=None if _EVERY else 100):
        (tmp_path / f"{name}.txt").write_bytes(damaged_file)
        store = FlashStore(f"{tmp_path}/")
        lines = store.load(name)
        # True: an older copy was used
        assert lines is not None and store.damaged == {name: True}
        # All lines of the copy except its checksum; after it the text ends with a line end.
        assert [*map(str.encode, lines)] == old.split(b"\n")[:-2]


@pytest.mark.parametrize("kind", [".old", ".new"])
def test_damage_to_unused_copies_does_nothing(kind: str, filled: Path, tmp_path: Path) -> None:
    """With a valid .txt, the .old and .new files are not used."""
    files = flash_files(str(filled))
    (tmp_path / "settings.txt").write_bytes(files["settings.txt"])
    undamaged = FlashStore(f"{tmp_path}/").load("settings")
    for damaged_file in damages(files["settings.old"], Dice(3), flips=20):
        (tmp_path / f"settings{kind}").write_bytes(damaged_file)
        store = FlashStore(f"{tmp_path}/")
        assert store.load("settings") == undamaged and not store.damaged


def test_a_file_with_a_right_checksum_is_damaged_if_it_is_not_text(
    tmp_path: Path,
) -> None:
    """The byte 0xFF never occurs in UTF-8."""
    text = b"$0=\xff\n"
    (tmp_path / "settings.txt").write_bytes(text + b"#crc32=%08x\n" % zlib.crc32(text))
    store = FlashStore(f"{tmp_path}/")
    # False: there is no older copy
    assert store.load("settings") is None and store.damaged == {"settings": False}


def test_damage_is_reported_when_the_port_is_opened_later(
    filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The report at power-up is lost if no program has the port open yet; the welcome when it is
    opened repeats it."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "board"
    shutil.copytree(filled, folder)
    (folder / "flash" / "settings.txt").write_bytes(b"\x80")  # not text: the older copy is used
    output: list[bytes] = []

    def script(bench: Bench) -> Iterator[Any]:
        yield bench.rig.ms(100)  # the start is over
        machine = bench.rig.controller
        machine.report._link = SimpleNamespace(write=output.append)
        machine.welcome()  # as the link does when its port is opened

    Bench("plain", str(folder)).run(script)
    assert b"[MSG:Damaged in flash: settings (older copy)]\r\n" in output


def test_the_machine_works_with_a_damaged_custom_py(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is the user's own Python on the board."""
    complete()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.dont_write_bytecode", True)  # or the older bytecode would run
    folder = str(tmp_path / "board")
    write_initial_files(folder)
    start_with_damaged_custom(folder, Dice(4), flips=6)


@pytest.mark.thorough
@needs_micropython
def test_micropython_starts_with_the_older_copy(filled: Path, tmp_path: Path) -> None:
    """The script damages all files, starts a machine, and prints how many reports of damage it
    has sent. "custom" is read only after the report at the start."""
    folder = tmp_path / "board"
    shutil.copytree(filled, folder)
    printed = run_micropython(_BENCH, "damage", folder, paths=PATHS)
    assert printed == f"{2 * len(NAMES) - 1}\n", "once at the start, and once more after a reset"
