"""A browser for all tests of the page, and for each of them a page and a machine of its own."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge import Bridge, Machine
from browser import HOMING, Person, browser, settings_file


@pytest.fixture(scope="module")
def opened() -> Iterator[Any]:
    """Not longer: while it is there, asyncio has a loop that others must not find."""
    with browser() as made:
        yield made


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Machine]]:
    """Makes machines of their own; the usual one starts while the test before waits for its."""

    def start(settings: dict[int, str], *options: str) -> Machine:
        return Machine(settings_file(tmp_path_factory.mktemp("machine"), settings), *options)

    def make(settings: dict[int, str], *options: str) -> Machine:
        if settings or options:
            return start(settings, *options)
        usual.append(start({}))
        return usual.pop(0)

    usual = [start({})]
    usual[0].waits_for(b"Grbl ")  # the first one has its kernels compiled, for all that follow

    yield make
    for machine in usual:
        machine.close()


@pytest.fixture
def person_at(
    opened: Any, machines: Callable[..., Machine], tmp_path: Path
) -> Iterator[Callable[..., Person]]:
    """Makes a person: settings, options of the simulator, what kind of screen they have."""
    ends: list[Callable[[], object]] = []
    people: list[Person] = []

    def make(
        settings: "dict[int, str] | None" = None, *options: str, on: "dict[str, Any] | None" = None
    ) -> Person:
        machine = machines(settings or {}, *options)
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


@pytest.fixture
def homer(person_at: Callable[..., Person]) -> Person:
    """At a machine that has switches, and is locked until it is homed."""
    made = person_at(HOMING, "--switches")
    made.open_from_disk()
    made.connect("Alarm")
    return made
