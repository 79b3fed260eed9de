"""Test saves: written only when the loop asks for it; a failed one does not stop the rest."""

import pytest
from control.saves import Saves
from fakes import FakeStore


def test_newest_save_is_written_when_the_loop_asks_for_it() -> None:
    """save() only notes the lines; write_due(), called while the machine is idle, stores the last
    ones."""
    store = FakeStore()
    saves = Saves(store)
    saves.save("settings", ["$0=1"])
    saves.save("settings", ["$0=2"])
    assert store.files == {}
    saves.write_due()
    assert store.files == {"settings": ["$0=2"]} and saves.load("settings") == ["$0=2"]


def test_failed_save_is_dropped_and_the_others_are_written() -> None:
    store = FakeStore("settings")
    saves = Saves(store)
    for name in ("coords", "settings", "startup"):
        saves.save(name, [name])
    with pytest.raises(OSError):
        saves.write_due()
    assert store.files == {"coords": ["coords"], "startup": ["startup"]}
    saves.write_due()
