"""Stored files are damaged in flash: the machine starts, uses the older copy, and reports it.

Power cuts are not damage: see test_flash_store.py. UGRBL_TORTURE starts a machine with every bit
of every file flipped, and with every file cut at every byte.
"""

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
    fill,
    furnish,
    kept_in,
    start_damaged,
    start_with_damaged_custom,
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
    complete()
    here = Path.cwd()
    folder = tmp_path_factory.mktemp("damage") / "board"
    fill(str(folder))
    os.chdir(here)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_a_machine_starts_with_the_older_copy_of_any_damaged_file(
    name: str, filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "board"
    shutil.copytree(filled, folder)
    start_damaged(str(folder), kept_in(str(folder)), name, Dice(1), None if _EVERY else 1)


@pytest.mark.parametrize("name", NAMES)
def test_damage_is_always_detected(name: str, filled: Path, tmp_path: Path) -> None:
    files = kept_in(str(filled))
    now, old = files[f"{name}.txt"], files[f"{name}.old"]
    (tmp_path / f"{name}.old").write_bytes(old)
    for spoilt in damages(now, Dice(2), None if _EVERY else 100):
        (tmp_path / f"{name}.txt").write_bytes(spoilt)
        store = FlashStore(f"{tmp_path}/")
        found = store.load(name)
        assert found is not None and store.damaged == {name: True}
        assert [*map(str.encode, found)] == old.split(b"\n")[:-2]


@pytest.mark.parametrize("kind", [".old", ".new"])
def test_damage_to_unused_copies_does_nothing(kind: str, filled: Path, tmp_path: Path) -> None:
    files = kept_in(str(filled))
    (tmp_path / "settings.txt").write_bytes(files["settings.txt"])
    whole = FlashStore(f"{tmp_path}/").load("settings")
    for spoilt in damages(files["settings.old"], Dice(3), 20):
        (tmp_path / f"settings{kind}").write_bytes(spoilt)
        store = FlashStore(f"{tmp_path}/")
        assert store.load("settings") == whole and not store.damaged


def test_a_file_with_a_right_checksum_is_damaged_if_it_is_not_text(
    tmp_path: Path,
) -> None:
    text = b"$0=\xff\n"
    (tmp_path / "settings.txt").write_bytes(text + b"#crc32=%08x\n" % zlib.crc32(text))
    store = FlashStore(f"{tmp_path}/")
    assert store.load("settings") is None and store.damaged == {"settings": False}


def test_damage_is_reported_when_the_port_is_opened_later(
    filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "board"
    shutil.copytree(filled, folder)
    (folder / "flash" / "settings.txt").write_bytes(b"\x80")
    said: list[bytes] = []

    def script(bench: Bench) -> Iterator[Any]:
        yield bench.rig.ms(100)
        machine = bench.rig.controller
        machine.report._link = SimpleNamespace(write=said.append)
        machine.welcome()

    Bench("plain", str(folder)).run(script)
    assert b"[MSG:Damaged in flash: settings (older copy)]\r\n" in said


def test_the_machine_works_with_a_damaged_custom_py(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    complete()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.dont_write_bytecode", True)  # or the older bytecode would run
    folder = str(tmp_path / "board")
    furnish(folder)
    start_with_damaged_custom(folder, Dice(4), 6)


@pytest.mark.thorough
@needs_micropython
def test_micropython_starts_with_the_older_copy(filled: Path, tmp_path: Path) -> None:
    folder = tmp_path / "board"
    shutil.copytree(filled, folder)
    said = run_micropython(_BENCH, "damage", folder, paths=PATHS)
    assert said == f"{2 * len(NAMES) - 1}\n", "once at the start, and once more after a reset"
