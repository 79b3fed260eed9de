"""The board's store on a real littlefs image, with a power cut at every write to flash."""

from __future__ import annotations

from typing import Any

import pytest
from lfs_flash import Files, Flash, cut
from ports.storage import flash_store
from ports.storage.flash_store import FlashStore
from ugrbl.device.deploy import SAVED

OLD, NEW = ["$0=10", "$110=500.5"], ["$0=3", "$110=1000", "$999=1"]


def attach(monkeypatch: pytest.MonkeyPatch, flash: Flash, fresh: bool = False) -> FlashStore:
    files = Files(flash, fresh)
    monkeypatch.setattr(flash_store, "open", files.open, raising=False)
    monkeypatch.setattr(flash_store, "os", files)
    return FlashStore()


def test_saved_text_is_loaded_and_the_older_copy_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store = attach(monkeypatch, Flash(), fresh=True)
    store.save("settings", OLD)
    store.save("settings", NEW)
    assert store.load("settings") == NEW
    with flash_store.open(f"/{SAVED}/settings.txt", "wb") as file:  # type: ignore[attr-defined]
        file.write(b"$0=")
    assert store.load("settings") == OLD


def test_a_file_never_saved_differs_from_a_lost_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store = attach(monkeypatch, Flash(), fresh=True)
    assert store.load("settings") == []
    store.save("settings", OLD)
    with flash_store.open(f"/{SAVED}/settings.txt", "wb") as file:  # type: ignore[attr-defined]
        file.write(b"$0=")
    assert store.load("settings") is None
    assert store.load("startup") == []


def test_a_power_cut_in_the_first_write_leaves_a_new_board_or_the_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    blank = Flash()
    attach(monkeypatch, blank, fresh=True)
    image = bytes(blank.buffer)
    chip = Flash(image)
    attach(monkeypatch, chip).save("settings", OLD)
    found = []
    for whole, (_, data) in enumerate([*chip.log, (0, b"")]):
        for torn in sorted({0, 1, len(data) // 2, max(len(data) - 1, 0)}):
            left = Flash(cut(image, chip.log, whole, torn))
            found.append(attach(monkeypatch, left).load("settings"))
    assert [] in found and OLD in found
    assert all(lines in ([], OLD) for lines in found)


def test_a_power_cut_at_any_write_leaves_the_old_or_the_new_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = Flash()
    attach(monkeypatch, first, fresh=True).save("settings", OLD)
    image = bytes(first.buffer)
    chip = Flash(image)
    attach(monkeypatch, chip).save("settings", NEW)
    found = set()
    for whole, (_, data) in enumerate([*chip.log, (0, b"")]):
        for torn in sorted({0, 1, len(data) // 2, max(len(data) - 1, 0)}):
            left = Flash(cut(image, chip.log, whole, torn))
            lines = attach(monkeypatch, left).load("settings")
            assert lines in (OLD, NEW), f"after {whole} operations and {torn} bytes"
            found.add(tuple(lines))
    assert len(found) == 2, "cuts must fall on both sides of the change"


def test_a_second_power_cut_leaves_the_text_read_before_or_the_new_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A valid copy is never overwritten."""
    first, third = Flash(), ["$0=5"]
    attach(monkeypatch, first, fresh=True).save("settings", OLD)
    chip = Flash(bytes(first.buffer))
    attach(monkeypatch, chip).save("settings", NEW)
    for whole in range(len(chip.log) + 1):
        image = cut(bytes(first.buffer), chip.log, whole, 0)
        again = Flash(image)
        store = attach(monkeypatch, again)
        there = store.load("settings")
        store.save("settings", third)
        for later in range(len(again.log) + 1):
            left = attach(monkeypatch, Flash(cut(image, again.log, later, 0)))
            assert left.load("settings") in (there, third), (whole, later)
            assert not left.damaged, "a power cut is not damage"


class FullFile:
    def __enter__(self) -> FullFile:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def write(self, _: bytes) -> int:
        raise OSError(28)


def test_a_full_flash_is_reported_and_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    store = attach(monkeypatch, Flash(), fresh=True)
    store.save("settings", OLD)
    working = flash_store.open  # type: ignore[attr-defined]

    def full(path: str, mode: str = "r") -> Any:
        return FullFile() if mode == "wb" else working(path, mode)

    monkeypatch.setattr(flash_store, "open", full)
    with pytest.raises(OSError, match="28"):
        store.save("settings", NEW)
    assert store.load("settings") == OLD


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_full_memory_is_reported_like_full_flash(
    turn: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While a file is written, while it is read back, while the older one is read."""
    store = attach(monkeypatch, Flash(), fresh=True)
    store.save("settings", OLD)
    working = flash_store.open  # type: ignore[attr-defined]
    opened: list[str] = []

    def open_or_fail(path: str, mode: str = "r") -> Any:
        opened.append(path)
        if len(opened) == turn:
            raise MemoryError("allocating 1253 bytes")
        return working(path, mode)

    monkeypatch.setattr(flash_store, "open", open_or_fail)
    with pytest.raises(OSError, match="12"):
        store.save("settings", NEW)
    assert store.load("settings") == OLD


@pytest.mark.parametrize("full", [False, True])
def test_a_write_calls_both_hooks_even_if_it_fails(
    full: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    attach(monkeypatch, Flash(), fresh=True)
    told: list[str] = []
    store = FlashStore()
    store.before, store.after = lambda: told.append("before"), lambda: told.append("after")
    assert store.load("settings") == [] and told == []
    if full:
        monkeypatch.setattr(FullFile, "read", lambda _: b"", raising=False)
        monkeypatch.setattr(flash_store, "open", lambda *_: FullFile(), raising=False)
        with pytest.raises(OSError, match="28"):
            store.save("settings", NEW)
    else:
        store.save("settings", NEW)
    assert told == ["before", "after"]
