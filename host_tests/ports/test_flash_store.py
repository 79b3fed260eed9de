"""The board's store on a real littlefs image, with a power cut at every write to flash.

Flash.log lists the operations that changed the chip. cut(image, log, whole, torn) returns the chip
as it is if power fails after `whole` complete operations and `torn` bytes of the next one. load()
returns [] if the name was never saved, None if it is lost."""

from __future__ import annotations

from typing import Any

import pytest
from lfs_flash import Files, Flash, cut
from ports.storage import flash_store
from ports.storage.flash_store import FlashStore
from ugrbl.device.deploy import SAVED

OLD, NEW = ["$0=10", "$110=500.5"], ["$0=3", "$110=1000", "$999=1"]


def attach(monkeypatch: pytest.MonkeyPatch, flash: Flash, fresh: bool = False) -> FlashStore:
    """Return a store on that chip. fresh: format the chip first."""
    files = Files(flash, fresh)
    monkeypatch.setattr(flash_store, "open", files.open, raising=False)
    monkeypatch.setattr(flash_store, "os", files)
    return FlashStore()


def test_saved_text_is_loaded_and_the_older_copy_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If the newest file is cut short, the copy before it is loaded."""
    store = attach(monkeypatch, Flash(), fresh=True)
    store.save("settings", OLD)
    store.save("settings", NEW)
    assert store.load("settings") == NEW
    with flash_store.open(f"/{SAVED}/settings.txt", "wb") as file:  # type: ignore[attr-defined]
        file.write(b"$0=")  # cut short: no checksum
    assert store.load("settings") == OLD


def test_a_file_never_saved_differs_from_a_lost_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The only copy is cut short; "startup" was never saved."""
    store = attach(monkeypatch, Flash(), fresh=True)
    assert store.load("settings") == []
    store.save("settings", OLD)
    with flash_store.open(f"/{SAVED}/settings.txt", "wb") as file:  # type: ignore[attr-defined]
        file.write(b"$0=")  # cut short: no checksum
    assert store.load("settings") is None
    assert store.load("startup") == []


def test_a_power_cut_in_the_first_write_leaves_a_new_board_or_the_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Power is cut at each operation on the chip while OLD is saved for the first time."""
    blank = Flash()
    attach(monkeypatch, blank, fresh=True)
    image = bytes(blank.buffer)
    chip = Flash(image)
    attach(monkeypatch, chip).save("settings", OLD)
    loaded = []
    for complete_operations, (_, data) in enumerate([*chip.log, (0, b"")]):
        # Cut the next operation after none, one, half, and all but one of its bytes.
        for torn_bytes in sorted({0, 1, len(data) // 2, max(len(data) - 1, 0)}):
            chip_after_cut = Flash(cut(image, chip.log, complete_operations, torn_bytes))
            loaded.append(attach(monkeypatch, chip_after_cut).load("settings"))
    assert [] in loaded and OLD in loaded
    assert all(lines in ([], OLD) for lines in loaded)


def test_a_power_cut_at_any_write_leaves_the_old_or_the_new_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Power is cut at each operation on the chip while NEW replaces OLD."""
    chip_with_old = Flash()
    attach(monkeypatch, chip_with_old, fresh=True).save("settings", OLD)
    image = bytes(chip_with_old.buffer)
    chip = Flash(image)
    attach(monkeypatch, chip).save("settings", NEW)
    loaded = set()
    for complete_operations, (_, data) in enumerate([*chip.log, (0, b"")]):
        # Cut the next operation after none, one, half, and all but one of its bytes.
        for torn_bytes in sorted({0, 1, len(data) // 2, max(len(data) - 1, 0)}):
            chip_after_cut = Flash(cut(image, chip.log, complete_operations, torn_bytes))
            lines = attach(monkeypatch, chip_after_cut).load("settings")
            assert lines in (OLD, NEW), (
                f"after {complete_operations} operations and {torn_bytes} bytes"
            )
            loaded.add(tuple(lines))
    assert len(loaded) == 2, "cuts must fall on both sides of the change"


def test_a_second_power_cut_leaves_the_text_read_before_or_the_new_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Power fails while NEW replaces OLD, and again while a third text is saved: a valid copy is
    never overwritten."""
    chip_with_old, third_text = Flash(), ["$0=5"]
    attach(monkeypatch, chip_with_old, fresh=True).save("settings", OLD)
    chip = Flash(bytes(chip_with_old.buffer))
    attach(monkeypatch, chip).save("settings", NEW)
    for complete_operations in range(len(chip.log) + 1):
        image = cut(bytes(chip_with_old.buffer), chip.log, complete_operations, 0)
        chip_after_cut = Flash(image)
        store = attach(monkeypatch, chip_after_cut)
        text_after_cut = store.load("settings")
        store.save("settings", third_text)
        for operations_later in range(len(chip_after_cut.log) + 1):
            store_after_second_cut = attach(
                monkeypatch, Flash(cut(image, chip_after_cut.log, operations_later, 0))
            )
            assert store_after_second_cut.load("settings") in (text_after_cut, third_text), (
                complete_operations,
                operations_later,
            )
            assert not store_after_second_cut.damaged, "a power cut is not damage"


class FullFile:
    def __enter__(self) -> FullFile:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def write(self, _: bytes) -> int:
        raise OSError(28)  # ENOSPC


def test_a_full_flash_is_reported_and_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file opened for writing raises ENOSPC (28)."""
    store = attach(monkeypatch, Flash(), fresh=True)
    store.save("settings", OLD)
    working_open = flash_store.open  # type: ignore[attr-defined]

    def is_full(path: str, mode: str = "r") -> Any:
        return FullFile() if mode == "wb" else working_open(path, mode)

    monkeypatch.setattr(flash_store, "open", is_full)
    with pytest.raises(OSError, match="28"):
        store.save("settings", NEW)
    assert store.load("settings") == OLD


@pytest.mark.parametrize("failing_open", [1, 2, 3])
def test_full_memory_is_reported_like_full_flash(
    failing_open: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Opening file number `failing_open` of a save fails: the one written, the same read back, the
    older one read. The error becomes ENOMEM (12), and the settings stay."""
    store = attach(monkeypatch, Flash(), fresh=True)
    store.save("settings", OLD)
    working_open = flash_store.open  # type: ignore[attr-defined]
    opened: list[str] = []

    def open_or_fail(path: str, mode: str = "r") -> Any:
        opened.append(path)
        if len(opened) == failing_open:
            raise MemoryError("allocating 1253 bytes")
        return working_open(path, mode)

    monkeypatch.setattr(flash_store, "open", open_or_fail)
    with pytest.raises(OSError, match="12"):
        store.save("settings", NEW)
    assert store.load("settings") == OLD


@pytest.mark.parametrize("is_full", [False, True])
def test_a_write_calls_both_hooks_even_if_it_fails(
    is_full: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """before() and after() enclose a save, not a load. is_full: the save fails."""
    attach(monkeypatch, Flash(), fresh=True)
    calls: list[str] = []
    store = FlashStore()
    store.before, store.after = lambda: calls.append("before"), lambda: calls.append("after")
    assert store.load("settings") == [] and calls == []
    if is_full:
        # A save reads the files that exist, too.
        monkeypatch.setattr(FullFile, "read", lambda _: b"", raising=False)
        monkeypatch.setattr(flash_store, "open", lambda *_: FullFile(), raising=False)
        with pytest.raises(OSError, match="28"):
            store.save("settings", NEW)
    else:
        store.save("settings", NEW)
    assert calls == ["before", "after"]
