"""The firmware on the desktop: stand-ins first, so that they win over others of the name."""

import gc
import os
import signal
import sys
from functools import cache
from pathlib import Path

import pytest
import rings
import typer.testing
from hypothesis import settings

_HERE = Path(__file__).parent

sys.path[:0] = [str(_HERE.parent / "tools" / "sim" / "standins"), str(_HERE.parent / "firmware")]
# Some tests take something from one of another folder. Helpers are in support/: pyproject.toml.
sys.path += sorted({str(file.parent) for file in _HERE.glob("*/test_*.py")})
# Said aloud, so that no tool under test switches the checks off for the tests after it.
os.environ.setdefault("UGRBL_VIPER", "checked")
# So wide that no line breaks, however long the name of a test's folder is.
os.environ["COLUMNS"] = "500"

# Typer would make all commands anew for each that a test types: 24 ms.
typer.testing._get_command = cache(typer.testing._get_command)

settings.register_profile("ring 1", deadline=None, max_examples=12)
settings.register_profile("ring 2", deadline=None, max_examples=50)
settings.register_profile("thorough", deadline=None, max_examples=2000)


def pytest_addoption(parser: pytest.Parser) -> None:
    rings.add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    rings.choose(config)
    usual = "ring 1" if rings.is_first() else "ring 2"
    settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", usual))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> "int | None":
    """In the second ring one more than there are cores: tests of pages and terminals wait."""
    return (os.cpu_count() or 1) + 1 if rings.is_second(config) else None


def pytest_collection_modifyitems(config: pytest.Config, items: "list[pytest.Item]") -> None:
    rings.select(config, items)


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    terminalreporter.write_line(rings.summary(config))


@pytest.fixture(autouse=True, scope="module")
def collections_of_tests() -> None:
    """When the firmware collects garbage, nobody looks through what was there before: 30 ms."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def turns_at_rest() -> None:
    """A machine at rest turns less often than in motion: a third of the tests' time. Recorded
    conversations are replayed by processes of their own, to the millisecond."""
    from ugrbl.sim.rig import Rig  # with the stand-ins in place

    Rig.idle_poll_ms = 4


@pytest.fixture
def each_ms(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that look at a machine at rest as closely as that."""
    from ugrbl.sim.rig import Rig

    monkeypatch.setattr(Rig, "idle_poll_ms", 1)


@pytest.fixture(autouse=True, scope="session")
def kernels_of_tests() -> None:
    """Kernels that are compiled for this computer: not in the user's folder, and all workers share
    them."""
    os.environ["UGRBL_KERNELS"] = str(_HERE.parent / "build" / "cache" / "tests" / "kernels")


# Who runs tests in the background may have these ignored, and what a test starts would inherit it.
for _number in (signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGINT)):
    if signal.getsignal(_number) == signal.SIG_IGN:
        signal.signal(_number, signal.SIG_DFL)
