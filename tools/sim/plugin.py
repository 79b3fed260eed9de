"""pytest: the fixture `grbl`, a simulated machine of its own for each test."""

from collections.abc import Iterator

import pytest

from .machine import Machine


@pytest.fixture
def grbl() -> Iterator[Machine]:
    """A machine with three axes and the settings of a factory, switched on and at rest."""
    with Machine() as machine:
        yield machine
