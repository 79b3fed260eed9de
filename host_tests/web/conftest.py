"""Provide one browser for all tests of the page, and a page and a machine for each test."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge import Bridge, Machine
from browser import HOMING, Person, browser, settings_file


@pytest.fixture(scope="module")
def opened() -> Iterator[Any]:
    """Open the browser for one module.

    While it is open, asyncio has a loop that other tests must not find.
    """
    with browser() as made:
        yield made


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Machine]]:
    """Return a maker of machines. The default machine for the next test is started in advance."""

    def start(settings: dict[int, str], *options: str) -> Machine:
        return Machine(settings_file(tmp_path_factory.mktemp("machine"), settings), *options)

    def make(settings: dict[int, str], *options: str) -> Machine:
        if settings or options:
            return start(settings, *options)
        usual.append(start({}))
        return usual.pop(0)

    usual = [start({})]
    usual[0].waits_for(b"Grbl ")  # the first machine compiles the kernels for all later ones

    yield make
    for machine in usual:
        machine.close()


@pytest.fixture
def person_at(
    opened: Any, machines: Callable[..., Machine], tmp_path: Path
) -> Iterator[Callable[..., Person]]:
    """Return a maker of persons from settings, simulator options and screen options."""
    ends: list[Callable[[], object]] = []
    people: list[Person] = []

    def make(
        settings: "dict[int, str] | None" = None, *options: str, on: "dict[str, Any] | None" = None
    ) -> Person:
        machine = machines(settings or {}, *options)
        bridge = Bridge(machine)
        # A page opened from disk may connect to nothing, so the stand-in of the port may not
        # either.
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
    """A person connected by USB to a machine that is ready."""
    made = person_at()
    made.open_from_disk()
    made.connect()
    return made


@pytest.fixture
def homer(person_at: Callable[..., Person]) -> Person:
    """A person at a machine that has switches and is locked until it is homed."""
    made = person_at(HOMING, "--switches")
    made.open_from_disk()
    made.connect("Alarm")
    return made
