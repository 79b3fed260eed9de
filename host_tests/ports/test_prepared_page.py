"""Prepared pages on a real littlefs image: erased in advance, written without the file system.

The file /pages is one block of flash (4096 bytes, 16 pages of 256). Its first page has a mark by
which the block is found in the chip; each other page takes one record: 6 bytes of length and
checksum, then the data. is_fresh(): all pages are blank. Flash.log lists the operations that
changed the chip; cut(image, log, whole, torn) returns the chip if power fails after `whole`
complete operations and `torn` bytes of the next one."""

from typing import Any

import pytest
from lfs_flash import BLOCK, PAGE, BlockDevice, Files, Flash, cut
from ports.storage import prepared_page
from ports.storage.prepared_page import PreparedPages

_RECORD = bytes(range(40))


def pages_on_chip(
    monkeypatch: pytest.MonkeyPatch, flash: Flash, fresh: bool = False
) -> "tuple[PreparedPages, Files]":
    """Return pages on that chip, and its files."""
    files = Files(flash, fresh)
    monkeypatch.setattr(prepared_page, "open", files.open, raising=False)
    monkeypatch.setattr(prepared_page, "os", files)
    monkeypatch.setattr(prepared_page, "flash_of_chip", lambda: BlockDevice(flash))
    pages = PreparedPages()
    pages.find()
    return pages, files


def count_erased(flash: Flash, log_length: int) -> int:
    """Return how many blocks have been erased since that entry of the log."""
    return sum(len(data) == BLOCK for _, data in flash.log[log_length:])


def test_record_is_one_page_without_an_erasure_and_survives_a_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Records are returned newest first. erase() prepares blank pages, and drops the records."""
    flash = Flash()
    pages, files = pages_on_chip(monkeypatch, flash, fresh=True)
    assert not pages.is_fresh() and not pages.write(_RECORD)  # nothing is prepared yet
    assert pages.erase()
    files.fs.open("/settings.txt", "wb").close()  # the file system goes on
    log_length = len(flash.log)
    assert pages.write(_RECORD) and pages.write(b"second")
    # two pages programmed, no block erased
    assert [len(data) for _, data in flash.log[log_length:]] == [PAGE, PAGE]
    after_start, files = pages_on_chip(monkeypatch, Flash(bytes(flash.buffer)))
    assert list(after_start.records()) == [b"second", _RECORD] and not after_start.is_fresh()
    assert after_start.erase() and list(after_start.records()) == []
    assert files.fs.stat("/pages").size == BLOCK


def test_pages_stay_where_they_are_while_other_files_are_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """200 writes of up to 9000 bytes to 7 other files make littlefs move its blocks."""
    flash = Flash()
    pages, files = pages_on_chip(monkeypatch, flash, fresh=True)
    pages.erase()
    assert pages.write(_RECORD)
    for number in range(200):
        with files.fs.open(f"/{number % 7}.txt", "wb") as file:
            file.write(bytes([number]) * (number * 97 % 9000))
    for _ in range(13):  # with _RECORD, 14 of 15 pages
        assert pages.write(b"more")
    after_start, _ = pages_on_chip(monkeypatch, Flash(bytes(flash.buffer)))
    assert list(after_start.records()) == [*[b"more"] * 13, _RECORD]


def test_last_page_is_used_and_no_other_block(monkeypatch: pytest.MonkeyPatch) -> None:
    flash = Flash()
    pages, _ = pages_on_chip(monkeypatch, flash, fresh=True)
    pages.erase()
    before = bytes(flash.buffer)
    written = [pages.write(b"%d" % i) for i in range(20)]  # 15 pages for records
    assert written == [True] * 15 + [False] * 5
    changed = {i // BLOCK for i in range(len(before)) if before[i] != flash.buffer[i]}
    assert len(changed) == 1


def test_record_that_a_power_cut_has_torn_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Power is cut after each byte of the page that is programmed: the older record stays
    valid."""
    flash = Flash()
    pages, _ = pages_on_chip(monkeypatch, flash, fresh=True)
    pages.erase()
    pages.write(b"first")
    image = bytes(flash.buffer)
    flash.log.clear()
    pages.write(_RECORD)
    for torn_bytes in range(PAGE + 1):
        pages_after_cut, _ = pages_on_chip(
            monkeypatch, Flash(cut(image, flash.log, 0, torn_bytes))
        )
        expected = (
            [_RECORD, b"first"] if torn_bytes >= 46 else [b"first"]
        )  # 6 bytes of head, 40 of data
        assert list(pages_after_cut.records()) == expected, torn_bytes


def test_power_cut_while_pages_are_prepared_leaves_the_record_or_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Power is cut at each operation of erase(), which drops the record."""
    flash = Flash()
    pages, _ = pages_on_chip(monkeypatch, flash, fresh=True)
    pages.erase()
    pages.write(_RECORD)
    image = bytes(flash.buffer)
    flash.log.clear()
    pages.erase()
    assert count_erased(flash, log_length=0)
    outcomes = set()
    for complete_operations, (_, data) in enumerate([*flash.log, (0, b"")]):
        # Cut the next operation after none, one, half, and all but one of its bytes.
        for torn_bytes in sorted({0, 1, len(data) // 2, max(len(data) - 1, 0)}):
            pages_after_cut, _ = pages_on_chip(
                monkeypatch, Flash(cut(image, flash.log, complete_operations, torn_bytes))
            )
            records = tuple(pages_after_cut.records())
            assert records in ((), (_RECORD,)), (complete_operations, torn_bytes)
            assert pages_after_cut.is_fresh() == (not records)
            outcomes.add(records)
    assert len(outcomes) == 2, "cuts must fall on both sides of the change"


def test_page_that_does_not_keep_it_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bit of the first page for records can no longer be 1: the record is written again, into
    the next page."""
    flash = Flash()
    pages, _ = pages_on_chip(monkeypatch, flash, fresh=True)
    pages.erase()
    flash.buffer[BLOCK * pages._block + PAGE + 8] = 0  # in the record: a worn cell
    log_length = len(flash.log)
    assert pages.write(_RECORD)
    # two pages were programmed
    assert len(flash.log) - log_length == 2 and list(pages.records()) == [_RECORD]


def test_file_system_that_keeps_files_elsewhere_is_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The mark is not found in the chip (other), for example because the file system is a FAT.
    Nothing is written to the chip; the file is made once, not at each start."""
    flash, other = Flash(), Flash()
    pages, _ = pages_on_chip(monkeypatch, flash, fresh=True)
    monkeypatch.setattr(prepared_page, "flash_of_chip", lambda: BlockDevice(other))
    log_lengths = []
    for _ in range(3):
        pages = PreparedPages()
        pages.find()
        assert not pages.erase() and not pages.write(_RECORD)
        log_lengths.append(len(flash.log))
    assert log_lengths[0] == log_lengths[2] > 0
    assert not any(other.buffer.strip(b"\xff"))


def test_desktop_has_no_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("a file of this computer")

    monkeypatch.setattr(prepared_page, "open", refuse, raising=False)
    pages = PreparedPages()
    pages.find()
    assert not pages.erase() and not pages.write(_RECORD) and not pages.is_fresh()
