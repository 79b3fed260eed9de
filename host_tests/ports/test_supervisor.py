"""The supervisor by itself: when it stops the machine, in which order; it never raises."""

from array import array
from types import SimpleNamespace

import pytest
from ports import supervisor
from ports.supervisor import Supervisor

_BEAT_MS = 5  # of a hard timer
_LIMIT_MS = 250


class Machine:
    """Link, engine and port at once, which log what is done to them. fails: who raises."""

    def __init__(self, fails: str = "") -> None:
        self.shared = array("i", (0, 0, 0, 7))
        self.log: list[str] = []
        self.fails = fails
        self.hears = False
        self.ms = 0
        self.watch = Supervisor(self, self, self, _LIMIT_MS)  # type: ignore[arg-type]
        self.watch.start(self.feed, self.reset)

    def _do(self, what: str) -> None:
        self.log.append(what)
        if what == self.fails:
            raise MemoryError

    def poll_reset(self) -> bool:
        """Ctrl-X comes while the test says so."""
        self._do("poll")
        return self.hears

    def reset(self, alarm: int) -> None:
        assert alarm == 0
        self._do("reset")

    def ticks_ms(self) -> int:
        return self.ms

    def elapsed_ms(self, since: int) -> int:
        return self.ms - since

    def feed(self) -> None:
        self._do("feed")

    def kill(self) -> None:
        self._do("kill")

    def stop(self) -> None:
        self._do("stop")

    def read(self) -> None:
        """The main loop turns."""
        self.shared[0] = 1
        if self.shared[1]:
            self.watch.raise_if_stopped()

    def beats(self, ms: int) -> "list[str]":
        """What is done while the main loop is away for so long."""
        self.log.clear()
        for _ in range(ms // _BEAT_MS):
            self.watch._timer.expire()
        return self.log


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    """On an RP2040."""
    monkeypatch.setattr(supervisor, "sys", SimpleNamespace(platform="rp2"))
    made = Machine()
    made.read()
    made.beats(_BEAT_MS)
    return made


def test_the_watchdog_is_fed_as_long_as_the_link_is_read(machine: Machine) -> None:
    for _ in range(20):
        machine.read()
        assert machine.beats(_BEAT_MS) == ["feed", "poll"]
    assert machine.beats(10) == ["poll", "poll"]


def test_a_main_loop_that_hangs_is_stopped_tools_first_and_at_every_beat(machine: Machine) -> None:
    assert machine.beats(_LIMIT_MS) == ["poll"] * 49 + ["kill", "stop"]
    assert machine.beats(10) == ["kill", "stop"] * 2
    with pytest.raises(RuntimeError, match="the main loop was away for 260 ms"):
        machine.read()
    machine.read()  # it is told once
    assert machine.beats(_BEAT_MS) == ["feed", "poll"]


def test_what_may_take_longer_says_so_and_is_stopped_after_that(machine: Machine) -> None:
    machine.watch.allow(1000)
    assert set(machine.beats(1000 + _LIMIT_MS - _BEAT_MS)) == {"poll"}
    assert machine.beats(_BEAT_MS) == ["kill", "stop"]


def test_soft_beats_that_have_waited_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on an ESP32, where eight may wait until flash has been written."""
    monkeypatch.setattr(supervisor, "sys", SimpleNamespace(platform="esp32"))
    timer = supervisor.Timer(-1)
    monkeypatch.setattr(supervisor, "Timer", lambda number: timer)
    machine = Machine()
    machine.watch.allow(2500)
    machine.ms = 1000
    machine.watch.allow(0)  # it has been written
    for _ in range(8):
        machine.watch._timer.expire()
    assert "kill" not in machine.log
    for _ in range(4):
        machine.ms += 50
        machine.watch._timer.expire()
    assert machine.log[-2:] == ["kill", "stop"], "it counts from there on"


@pytest.mark.parametrize("fails", ["feed", "poll", "reset"])
def test_an_interrupt_that_fails_stops_the_machine_and_is_reported(
    machine: Machine, fails: str
) -> None:
    machine.fails = fails
    machine.hears = True
    machine.read()
    stops = [what for what in machine.beats(_BEAT_MS) if what in ("kill", "stop")]
    assert stops == ["kill", "stop"]
    with pytest.raises(RuntimeError, match="interrupt has failed"):
        machine.read()


def test_ctrl_x_resets_also_while_the_main_loop_is_away(machine: Machine) -> None:
    machine.hears = True
    assert machine.beats(_BEAT_MS) == ["poll", "kill", "stop", "reset"]


def test_the_engine_is_stopped_also_where_killing_the_tool_fails(machine: Machine) -> None:
    machine.fails = "kill"
    machine.beats(_LIMIT_MS - _BEAT_MS)
    assert machine.beats(_BEAT_MS) == ["kill", "stop"]


def test_what_the_link_remembers_besides_is_left_alone(machine: Machine) -> None:
    machine.beats(1000)
    assert machine.shared[3] == 7
