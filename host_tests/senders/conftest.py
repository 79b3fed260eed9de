"""These run when asked for by name (`make test-senders`): they install programs, and take long."""

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave this folder out of plain runs."""
    return None if any("senders" in argument for argument in config.args) else True
