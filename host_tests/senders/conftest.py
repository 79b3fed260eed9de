"""Tests with real senders run only when named (`make test-senders`): they install programs, and
take long."""

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave this folder out unless it is named."""
    return None if any("senders" in argument for argument in config.args) else True
