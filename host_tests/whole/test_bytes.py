"""Bytes of a sender that are not text stop nothing: each line gets Grbl's answer, and jobs
continue.

UGRBL_TORTURE tries every byte in every place.
"""

import os
from pathlib import Path

import pytest
from base.text import text_of
from byte_bench import BOARDS, MICROPYTHONS, send_foreign_bytes, write_initial_files
from extras.dialects import dialect_hal
from micropython_runner import needs_micropython, run_micropython
from ports.storage.job_files import JobFiles
from ugrbl.paths import FIRMWARE
from ugrbl.run.board_modules import complete

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)

_ROOT = Path(__file__).parents[2]
_SUPPORT = _ROOT / "host_tests" / "support"
_EVERY = os.environ.get("UGRBL_TORTURE") is not None  # every byte, not samples

# Module search path of the simulator under MicroPython.
PATHS = [_SUPPORT, FIRMWARE, _ROOT, _ROOT / "tools"]


@pytest.mark.parametrize("board", BOARDS)
def test_any_byte_in_any_place_is_answered(
    board: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Send lines with foreign bytes to a simulated board; talk() checks each line's answer."""
    complete()  # add the functions of MicroPython to `time`
    monkeypatch.chdir(tmp_path)
    folder = str(tmp_path / "board")
    write_initial_files(folder)  # job files, custom modules and texts for this board
    # As on a board: a simulator made by another test has replaced this function.
    monkeypatch.setattr(dialect_hal, "texts", lambda: open(f"{folder}/{dialect_hal.FILE}", "rb"))
    seed = sum(board.encode())
    lines_sent = send_foreign_bytes(board, folder, seed, how_many=None if _EVERY else 2)
    assert lines_sent > 150


@needs_micropython
def test_micropython_answers_any_byte_in_any_place(tmp_path: Path) -> None:
    program = _SUPPORT / "byte_bench.py"
    said = run_micropython(program, "talk", tmp_path / "board", paths=PATHS, timeout=120)
    assert [line.rpartition(" ")[0] for line in said.splitlines()] == [*MICROPYTHONS]


def test_text_keeps_printable_characters_and_replaces_all_others() -> None:
    assert text_of(b"G1 X~") == "G1 X~"
    assert text_of(bytearray(b"\x00A\tB\x7f\x80\xc3\xa9\xff")) == " A B?????"
    assert all(text_of(bytes([byte])).isprintable() for byte in range(256))


def test_files_that_are_not_jobs_are_left_alone(tmp_path: Path) -> None:
    """Files with other names stay; rests of interrupted uploads of ours (NAME~NEW) are removed."""
    foreign_names = [
        b"\xff~NEW",
        b"\xe9.NC",
        b"small~NEW",
        b"~NEW",
        b"\x80~WHOLE",
        b"two words~NEW",
    ]
    for name in foreign_names:
        Path(os.fsdecode(os.path.join(os.fsencode(tmp_path), name))).write_bytes(b"G21\n")
    (tmp_path / "CUT.NC~NEW").write_bytes(b"G2")
    files = JobFiles(str(tmp_path))
    files.connect(None, None)  # type: ignore[arg-type]  # without a store and a link
    assert files.files() == []
    file = files.begin("A.NC")  # an upload begins: rests of earlier ones are removed
    files.append(file, b"G20\n")
    files.drop("A.NC", file)
    names_after = set(os.listdir(os.fsencode(tmp_path)))
    assert names_after == set(foreign_names) - {b"small~NEW"}, (
        "this name is one of ours, in any case"
    )
