"""A browser for all tests of the page, and for each of them a page and a machine of its own."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge import Bridge, Machine
from browser import Person, browser, settings_file


@pytest.fixture(scope="module")
def opened() -> Iterator[Any]:
    """Not longer: while it is there, asyncio has a loop that others must not find."""
    with browser() as made:
        yield made


@pytest.fixture
def person_at(opened: Any, tmp_path: Path) -> Iterator[Callable[..., Person]]:
    """Makes a person: settings, options of the simulator, what kind of screen they have."""
    ends: list[Callable[[], object]] = []
    people: list[Person] = []

    def make(
        settings: "dict[int, str] | None" = None, *options: str, on: "dict[str, Any] | None" = None
    ) -> Person:
        machine = Machine(settings_file(tmp_path, settings or {}), *options)
        bridge = Bridge(machine)
        # Opened from disk the page may connect to nothing, the stand-in of the port too.
        usual = {"viewport": {"width": 1280, "height": 900}, "bypass_csp": True}
        context = opened.new_context(**{**usual, **(on or {})})
        ends.extend((context.close, bridge.shutdown, machine.close))
        people.append(Person(context.new_page(), machine, bridge, tmp_path))
        return people[-1]

    yield make
    for end in ends:
        end()
    assert not [fault for person in people for fault in person.faults], "the script failed"


@pytest.fixture
def person(person_at: Callable[..., Person]) -> Person:
    """Connected by USB to a machine that is ready."""
    made = person_at()
    made.open_from_disk()
    made.connect()
    return made
