"""The supervisor alone: when it stops the machine, in which order; it never raises.

At each beat of a timer it checks whether the main loop has read the link since the last one. If
so, it feeds the watchdog; if not for _LIMIT_MS, it stops the machine: kill (the tool), then stop
(the motors). At each beat it polls the link for Ctrl-X, which resets."""

from array import array
from types import SimpleNamespace

import pytest
from ports import supervisor
from ports.supervisor import Supervisor

_BEAT_MS = 5  # period of a hard timer
_LIMIT_MS = 250


class Machine:
    """Link, engine and port in one, which log their calls. failing_call: the one that raises;
    has_ctrl_x: the link has received it; ms: the time. shared: [0] 1 if the loop has read the
    link, [1] why the machine was stopped (0: it was not), [2] ms since the loop read, [3] not of
    the supervisor."""

    def __init__(self, failing_call: str = "") -> None:
        self.shared = array("i", (0, 0, 0, 7))
        self.log: list[str] = []
        self.failing_call = failing_call
        self.has_ctrl_x = False
        self.ms = 0
        self.watch = Supervisor(self, self, self, _LIMIT_MS)  # type: ignore[arg-type]
        self.watch.start(self.feed, self.reset)

    def _log_call(self, what: str) -> None:
        self.log.append(what)
        if what == self.failing_call:
            raise MemoryError

    def poll_reset(self) -> bool:
        """Log the call; return whether Ctrl-X has arrived."""
        self._log_call("poll")
        return self.has_ctrl_x

    def reset(self, alarm: int) -> None:
        assert alarm == 0
        self._log_call("reset")

    def ticks_ms(self) -> int:
        return self.ms

    def elapsed_ms(self, since: int) -> int:
        return self.ms - since

    def feed(self) -> None:
        self._log_call("feed")

    def kill(self) -> None:
        self._log_call("kill")

    def stop(self) -> None:
        self._log_call("stop")

    def read(self) -> None:
        """Do what a turn of the main loop does."""
        self.shared[0] = 1
        if self.shared[1]:
            self.watch.raise_if_stopped()

    def run_beats(self, ms: int) -> "list[str]":
        """Return the calls during this time without a turn of the main loop."""
        self.log.clear()
        for _ in range(ms // _BEAT_MS):
            self.watch._timer.expire()
        return self.log


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Return a machine on an RP2040."""
    monkeypatch.setattr(supervisor, "sys", SimpleNamespace(platform="rp2"))
    machine_on_rp2040 = Machine()
    machine_on_rp2040.read()
    machine_on_rp2040.run_beats(_BEAT_MS)
    return machine_on_rp2040


def test_the_watchdog_is_fed_only_while_the_link_is_read(machine: Machine) -> None:
    """10 ms are two beats."""
    for _ in range(20):
        machine.read()
        assert machine.run_beats(_BEAT_MS) == ["feed", "poll"]
    assert machine.run_beats(10) == ["poll", "poll"]


def test_a_hanging_main_loop_is_stopped_tool_first_at_every_beat(machine: Machine) -> None:
    """250 ms are 50 beats; the one that reaches the limit stops the machine."""
    assert machine.run_beats(_LIMIT_MS) == ["poll"] * 49 + ["kill", "stop"]
    assert machine.run_beats(10) == ["kill", "stop"] * 2
    with pytest.raises(RuntimeError, match="the main loop was blocked for 260 ms"):
        machine.read()
    machine.read()  # raised once
    assert machine.run_beats(_BEAT_MS) == ["feed", "poll"]


def test_an_announced_longer_task_is_stopped_after_its_time(machine: Machine) -> None:
    """allow(1000): the main loop may be away 1000 ms more than the limit."""
    machine.watch.allow(1000)
    assert set(machine.run_beats(1000 + _LIMIT_MS - _BEAT_MS)) == {"poll"}
    assert machine.run_beats(_BEAT_MS) == ["kill", "stop"]


def test_several_delayed_soft_beats_count_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on an ESP32, whose timer interrupts wait while flash is written: eight of them then come
    at once, and count as one beat, 50 ms. Four more, 50 ms apart, reach the limit."""
    monkeypatch.setattr(supervisor, "sys", SimpleNamespace(platform="esp32"))
    timer = supervisor.Timer(-1)
    monkeypatch.setattr(supervisor, "Timer", lambda number: timer)
    machine = Machine()
    machine.watch.allow(2500)  # ms, before flash is written
    machine.ms = 1000
    machine.watch.allow(0)  # flash has been written
    for _ in range(8):
        machine.watch._timer.expire()
    assert "kill" not in machine.log
    for _ in range(4):
        machine.ms += 50
        machine.watch._timer.expire()
    assert machine.log[-2:] == ["kill", "stop"], "after five beats"


@pytest.mark.parametrize("failing_call", ["feed", "poll", "reset"])
def test_a_failing_interrupt_stops_the_machine_and_is_reported(
    machine: Machine, failing_call: str
) -> None:
    """One of the functions that the interrupt calls raises. Ctrl-X makes it call reset, too."""
    machine.failing_call = failing_call
    machine.has_ctrl_x = True
    machine.read()
    stops = [what for what in machine.run_beats(_BEAT_MS) if what in ("kill", "stop")]
    assert stops == ["kill", "stop"]
    with pytest.raises(RuntimeError, match="interrupt has failed"):
        machine.read()


def test_ctrl_x_resets_even_while_the_main_loop_hangs(machine: Machine) -> None:
    machine.has_ctrl_x = True
    assert machine.run_beats(_BEAT_MS) == ["poll", "kill", "stop", "reset"]


def test_the_engine_is_stopped_even_if_switching_off_the_tool_fails(machine: Machine) -> None:
    machine.failing_call = "kill"
    machine.run_beats(_LIMIT_MS - _BEAT_MS)
    assert machine.run_beats(_BEAT_MS) == ["kill", "stop"]


def test_other_shared_bytes_of_the_link_are_not_changed(machine: Machine) -> None:
    machine.run_beats(1000)
    assert machine.shared[3] == 7
