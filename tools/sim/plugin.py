"""pytest plugin: the fixture `grbl`, a separate simulated machine for each test."""

from collections.abc import Iterator

import pytest

from .machine import Machine


@pytest.fixture
def grbl() -> Iterator[Machine]:
    """A machine with three axes and factory settings, switched on and idle."""
    with Machine() as machine:
        yield machine
