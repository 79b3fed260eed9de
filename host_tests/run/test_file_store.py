"""Settings kept in a file between runs of the simulator."""

import os
from pathlib import Path
from typing import Any

import pytest
from ugrbl.grbl.settings_file import Firmware, Settings, SettingsError
from ugrbl.run.file_store import FileStore

_GRBL = Firmware("1.1", "h", "20190830", "Grbl", "V,15,128")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the path of a settings file that does not exist yet."""
    return tmp_path / "settings.txt"


def test_a_new_store_has_no_settings(path: Path) -> None:
    assert FileStore(path).load("settings") is None


def test_saved_text_is_loaded_in_the_next_run(path: Path) -> None:
    store = FileStore(path)
    store.save("settings", ["$0=10", "$7=1"])
    store.save("startup", ["", "G21"])
    store = FileStore(path)
    assert store.load("settings") == ["$0=10", "$7=1"]
    assert store.load("startup") == ["", "G21"]


def test_a_line_may_look_like_another_kind_of_line(path: Path) -> None:
    """The text of $I= ("build") is free: it must not be read as a section."""
    FileStore(path).save("build", ["[settings]", "  [x]", ";[startup] G21"])
    store = FileStore(path)
    assert store.load("build") == ["[settings]", "  [x]", ";[startup] G21"]
    assert store.load("settings") == store.load("startup") is None


def test_a_second_save_replaces_the_first(path: Path) -> None:
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


def test_sections_missing_in_the_file_get_factory_values(path: Path) -> None:
    path.write_text("$110=600\n")
    store = FileStore(path, {"settings": ["$0=10"], "startup": ["", ""]})
    assert store.load("settings") == ["$110=600"]
    assert store.load("startup") == ["", ""]


# The same format as `ugrbl settings pull`


def test_a_pulled_file_is_read(path: Path) -> None:
    values = {0: "10", 100: "250.000"}
    path.write_text(Settings(_GRBL, values).text("as pulled"))
    assert FileStore(path, firmware=_GRBL).load("settings") == ["$0=10", "$100=250.000"]


def test_a_saved_file_can_be_pushed(path: Path) -> None:
    """`ugrbl settings push` reads it; all but settings is in comments."""
    store = FileStore(path, firmware=_GRBL)
    store.save("settings", ["$0=10", "$100=250"])
    store.save("startup", ["G21", ""])
    store.save("coords", ["G54=1,2,3"])
    read = Settings.read(path.read_text())
    assert read.values == {0: "10", 100: "250"}
    assert str(read.firmware) == str(_GRBL)
    assert not [line for line in path.read_text().splitlines() if line[0] not in ";$"]


def test_comments_and_number_formats_of_a_file_are_kept(path: Path) -> None:
    """Only the number that has changed is replaced; a new setting is appended."""
    path.write_text("; my mill\n  $0 = 10.0 (as the driver wants)\n$110=600 ; slow, $110=600\n")
    store = FileStore(path)
    store.save("settings", ["$0=10", "$110=700", "$111=500"])
    assert path.read_text() == (
        "; my mill\n  $0 = 10.0 (as the driver wants)\n$110=700 ; slow, $110=600\n$111=500\n"
    )


# A file that was not read and understood is never overwritten


@pytest.mark.parametrize(
    "foreign",
    [
        b"\x00\xff\xfe",
        b"[settings]\n    $0=10\n\xa7\xa7\n",
        b"G21 G90\nG1 X10 F600\n",
        b"(a program)\n$H\nG0 X1\n",
        b"; a comment and nothing else\n",
        b"$0=10\n$0=11\n",
        b"$110=fast\n",
        b"$110=inf\n",
        b"$110=1e39\n",
        b"$0=10\n$0\n",
        b"; [VER:0.9j.20150717:]\n$0=10\n",
    ],
)
def test_a_file_that_is_not_understood_is_refused_and_not_changed(
    path: Path, foreign: bytes
) -> None:
    path.write_bytes(foreign)
    with pytest.raises(SettingsError):
        FileStore(path, firmware=_GRBL)
    assert path.read_bytes() == foreign


def test_a_file_changed_by_another_program_is_not_overwritten(path: Path) -> None:
    """The store compares the file with what it read or wrote last."""
    store = FileStore(path)
    store.save("settings", ["$0=10"])
    path.write_text("$0=20\n")
    with pytest.raises(OSError, match="changed by another program"):
        store.save("settings", ["$0=11"])
    assert path.read_text() == "$0=20\n"


def test_a_file_created_by_another_program_is_not_overwritten(path: Path) -> None:
    store = FileStore(path)
    path.write_text("precious")
    with pytest.raises(OSError, match="changed by another program"):
        store.save("settings", ["$0=11"])
    assert path.read_text() == "precious"


def test_a_failed_save_leaves_no_temporary_file(path: Path, monkeypatch: Any) -> None:
    """A new file is written next to the old one, then replaces it; here the disk is full."""
    FileStore(path).save("settings", ["$0=10"])
    store = FileStore(path)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")  # ENOSPC

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="the disk is full"):
        store.save("settings", ["$0=11"])
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert FileStore(path).load("settings") == ["$0=10"]


def test_a_link_to_the_file_stays_a_link(path: Path) -> None:
    link = path.with_name("link")
    path.write_text("$0=10\n")
    link.symlink_to(path.name)
    FileStore(link).save("settings", ["$0=11"])
    assert link.is_symlink() and path.read_text() == "$0=11\n"


def test_a_missing_folder_is_reported_at_once(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="no folder"):
        FileStore(tmp_path / "nowhere" / "settings")
