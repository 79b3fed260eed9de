"""Settings kept in a file between runs of the simulator."""

from pathlib import Path

import pytest
from ugrbl.file_store import FileStore


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "settings.txt"


def test_nothing_is_kept_at_first(path: Path) -> None:
    assert FileStore(path).load("settings") is None


def test_what_is_saved_is_loaded_in_the_next_run(path: Path) -> None:
    store = FileStore(path)
    store.save("settings", ["$0=10", "$I=[a]"])
    store.save("startup", [])
    store = FileStore(path)
    assert store.load("settings") == ["$0=10", "$I=[a]"]
    assert store.load("startup") == []


def test_a_line_may_look_like_the_name_of_a_section(path: Path) -> None:
    FileStore(path).save("build", ["[settings]", "  [x]"])
    store = FileStore(path)
    assert store.load("build") == ["[settings]", "  [x]"]
    assert store.load("settings") is None


def test_saving_again_replaces(path: Path) -> None:
    store = FileStore(path)
    store.save("settings", ["$0=10", "$1=25"])
    store.save("settings", ["$0=11"])
    assert FileStore(path).load("settings") == ["$0=11"]


def test_a_failed_save_leaves_the_file_as_it_was(path: Path) -> None:
    def broken():
        yield "$0=11"
        raise OSError("disk full")

    FileStore(path).save("settings", ["$0=10"])
    with pytest.raises(OSError, match="disk full"):
        FileStore(path).save("settings", broken())
    assert FileStore(path).load("settings") == ["$0=10"]


@pytest.mark.parametrize(
    "damaged",
    [
        b"",
        b"\x00\xff\xfe",
        b"[settings\n$$$",
        b"    $0=10\n",
        b"[settings]\n    $0=10\n\xa7\xa7\n",
        b"[settings]\n    $0=1\x00\n",
    ],
)
def test_a_damaged_file_counts_as_empty(path: Path, damaged: bytes) -> None:
    path.write_bytes(damaged)
    assert FileStore(path).load("settings") is None
