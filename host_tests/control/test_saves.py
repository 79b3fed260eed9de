"""Saves: nothing is written before the loop says so, and what fails does not keep the rest."""

import pytest
from control.saves import Saves
from fakes import FakeStore


def test_what_is_saved_is_written_when_the_loop_says_so_the_newest_only() -> None:
    store = FakeStore()
    saves = Saves(store)
    saves.save("settings", ["$0=1"])
    saves.save("settings", ["$0=2"])
    assert store.files == {}
    saves.write_due()
    assert store.files == {"settings": ["$0=2"]} and saves.load("settings") == ["$0=2"]


def test_where_one_finds_no_room_the_others_are_kept_and_it_is_not_tried_again() -> None:
    store = FakeStore("settings")
    saves = Saves(store)
    for name in ("coords", "settings", "startup"):
        saves.save(name, [name])
    with pytest.raises(OSError):
        saves.write_due()
    assert store.files == {"coords": ["coords"], "startup": ["startup"]}
    saves.write_due()
