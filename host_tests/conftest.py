"""Put the desktop stand-ins first on the path, and set up pytest for all host tests."""

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
# Some tests import from a test of another folder. Helpers are in support/: see pyproject.toml.
sys.path += sorted({str(file.parent) for file in _HERE.glob("*/test_*.py")})
# Set explicitly, so that no tool under test switches the checks off for later tests.
os.environ.setdefault("UGRBL_VIPER", "checked")
# Wide enough that no line of output wraps, however long a test's folder name is.
os.environ["COLUMNS"] = "500"

# Typer would rebuild all commands for each command line that a test runs: 24 ms.
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
    """Return one worker more than there are cores in the second ring: tests of pages and terminals
    wait."""
    return (os.cpu_count() or 1) + 1 if rings.is_second(config) else None


def pytest_collection_modifyitems(config: pytest.Config, items: "list[pytest.Item]") -> None:
    rings.select(config, items)


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    terminalreporter.write_line(rings.summary(config))


@pytest.fixture(autouse=True, scope="module")
def collections_of_tests() -> None:
    """Freeze older objects, so that the firmware's garbage collections skip them: 30 ms each."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def turns_at_rest() -> None:
    """Poll an idle machine less often than a moving one: saves a third of the tests' time.

    Recorded conversations are replayed by separate processes, to the millisecond."""
    from ugrbl.sim.rig import Rig  # only after the stand-ins are in place

    Rig.idle_poll_ms = 4


@pytest.fixture
def each_ms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poll an idle machine each millisecond, for tests that need that resolution."""
    from ugrbl.sim.rig import Rig

    monkeypatch.setattr(Rig, "idle_poll_ms", 1)


@pytest.fixture(autouse=True, scope="session")
def kernels_of_tests() -> None:
    """Cache kernels compiled for this computer in build/, not in the user's folder; all workers
    share
    them."""
    os.environ["UGRBL_KERNELS"] = str(_HERE.parent / "build" / "cache" / "tests" / "kernels")


# A shell may ignore these signals for background jobs; processes that tests start inherit that.
for _number in (signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGINT)):
    if signal.getsignal(_number) == signal.SIG_IGN:
        signal.signal(_number, signal.SIG_DFL)
