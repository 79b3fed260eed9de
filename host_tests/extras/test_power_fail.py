"""POWER_FAIL: the supply fails at any moment, and is gone at any later one.

The flash of the record is a littlefs image. A page takes 3 ms, the longest of the data sheet; a
cut in that time leaves a part of it.

The failing supply opens a contact (the edge), and lasts 100 ms longer. Power.fails_in_job(ms) runs
a job, and lets the supply fail so many ms after its beginning. Then `writes` has the ms of page
writes after the edge, `steps` the motors' steps at each of 200 ms. Power.flash_after(ms) returns
the flash if the supply is gone at that ms, Power.next_start(flash) the output of the next start,
and Power.position_at(ms) the position. ALARM:36 is a failed supply, ALARM:3 a lost position.
"""

import copy
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lfs_flash import PAGE, BlockDevice, Files, Flash, cut
from machine import Pin
from ports.storage import prepared_page
from test_jobs import FAST, HOMED, Bench, say, until_job_ends, with_switches

_PIN = 22  # of the contact; 0: the supply is present
_PAGE_MS = 3  # to write a page of flash
_STEPS_PER_MM = 250
_JOB = "PART.NC"
_LINES = (
    "G21G91G1F3000M3S1000",
    *(f"X{-0.5 if i % 2 else -0.4}Y{-0.1 * (i % 3):.1f}Z{-0.02 * (i % 2)}" for i in range(60)),
)
_REPORT = re.compile(
    r"\[MSG:(?:Job (?P<job>\S+): power failed at line (?P<line>\d+)|Power failed), "
    r"(?P<sure>[^:]*): X(?P<X>-?[\d.]+) Y(?P<Y>-?[\d.]+) Z(?P<Z>-?[\d.]+)\]"
)
_CERTAIN = "position certain"
_UNFINISHED = f"[MSG:Job {_JOB}: did not finish; last recorded line: "


class Power:
    """The supply of a machine with POWER_FAIL, and its flash. The machine's bench is `bench`."""

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path, **options: Any) -> None:
        """folder: holds the job. options: more options of the board file."""
        self._patch = patch
        self.folder = folder
        self.options = {"POWER_FAIL": _PIN, **options}
        self.flash = Flash()
        self.store: Any = None
        self.bench = self.machine(fresh=True)
        # At the edge of the last failure: flash and stored files. After it: ms of each write to
        # flash and steps at each ms.
        self.image = b""
        self.files: dict[str, list[str]] = {}
        self.writes: list[float] = []
        self.steps: list[list[int]] = []
        self._log: list[tuple[int, bytes]] = []
        self._edge_ms = 0.0

    def machine(self, *, fresh: bool = False, image: "bytes | None" = None) -> Bench:
        """Return a machine that is powered now.

        image: the content of its flash, None: as it is; fresh: flash without files.
        """
        if image is not None:
            self.flash = Flash(image)
        # Level 0 of the contact: the supply is present.
        Pin.pins.pop(_PIN, None)
        Pin(_PIN).drive(0)
        files, device = Files(self.flash, fresh), BlockDevice(self.flash)
        device.on_write = lambda: self.writes.append(self._now_ms() - self._edge_ms)
        self._patch.setattr(prepared_page, "open", files.open, raising=False)
        self._patch.setattr(prepared_page, "os", files)
        self._patch.setattr(prepared_page, "flash_of_chip", lambda: device)
        self.bench = with_switches(Bench(self.folder, self.store, **self.options))
        self.store = self.bench.store
        return self.bench

    def _now_ms(self) -> float:
        return float(self.bench.rig.now / self.bench.rig.ticks_per_ms)

    def fail(self, lasts_ms: int = 200) -> Iterator[Any]:
        """Open the contact, which is an interrupt; then record the steps at each ms.

        The tool must be off all the time.
        """
        rig = self.bench.rig
        self._edge_ms = self._now_ms()
        self.image, self.files = bytes(self.flash.buffer), copy.deepcopy(self.store.files)
        self._log = self.flash.log
        for log in (self._log, self.writes, self.steps):
            log.clear()
        Pin(_PIN).drive(1)
        for _ in range(lasts_ms):
            assert not rig.port.spindle_on and not rig.port.spindle_pwm
            rig.engine.position(rig.scratch)
            self.steps.append(list(rig.scratch))
            yield rig.ms(1)

    def fails_in_job(
        self, after_ms: float, *settings: str, lines: "tuple[str, ...]" = _LINES
    ) -> "list[str]":
        """Run a job, let the supply fail so many ms after its beginning, and return the output."""
        self.bench.put(_JOB, *lines)

        def script(bench: Bench) -> Iterator[Any]:
            """Start the job, wait until its start is recorded, and fail after_ms later."""
            yield from say(*FAST, *HOMED, *settings, f"$F={_JOB}", wait_s=0)(bench)
            yield from bench.sender.until(lambda: bench.job_record() != [])
            bench.sender.take()
            yield bench.rig.ms(after_ms)
            yield from self.fail()

        return self.bench.run(script)

    def flash_after(self, after_ms: float) -> bytes:
        """Return the flash of a supply that was gone so many ms after the edge."""
        # Of the last page only a part is written, in proportion to the time.
        begun_pages = sum(ms < after_ms for ms in self.writes)
        whole_pages = sum(ms + _PAGE_MS <= after_ms for ms in self.writes)
        torn_bytes = 0
        if begun_pages > whole_pages:
            torn_bytes = int(PAGE * (after_ms - self.writes[whole_pages]) / _PAGE_MS)
        return cut(self.image, self._log, whole_pages, torn_bytes)

    def next_start(self, image: bytes) -> "list[str]":
        """Return the messages of the next start with this flash, and the files of the edge."""
        self.store.files = copy.deepcopy(self.files)
        return self.machine(image=image).run(say("$G", wait_s=0))

    def position_at(self, ms: float) -> "dict[str, float]":
        """Return the position so many ms after the edge, as reports print it."""
        steps = self.steps[min(int(ms), len(self.steps) - 1)]
        return {axis: round(steps[i] / _STEPS_PER_MM, 3) for i, axis in enumerate("XYZ")}

    def lines_with(self, steps: "list[int]") -> "set[int]":
        """Return the lines of the job on whose way these steps are."""
        lines, start_mm = set(), None
        for line, (_, _, target_mm, _) in self.bench.log:
            if start_mm and line:
                axes = zip(start_mm, target_mm, steps, strict=False)
                if all(
                    min(a, b) - 0.005 <= n / _STEPS_PER_MM <= max(a, b) + 0.005 for a, b, n in axes
                ):
                    lines.add(line)
            start_mm = target_mm
        return lines


def report(output: "list[str]") -> "dict[str, Any]":
    """Return the parts of the report: job, line, sure, X, Y and Z; {} without one."""
    matches = [match for match in map(_REPORT.match, output) if match]
    assert len(matches) <= 1, output
    return matches[0].groupdict() if matches else {}


def has_planned(bench: Bench, line: int) -> bool:
    """Return whether that line of the job has been planned."""
    return any(entry[0] >= line for entry in bench.log)


def position_mm(parts: "dict[str, Any]") -> "dict[str, float]":
    """Return the position of a report in mm."""
    return {axis: float(parts[axis]) for axis in "XYZ"}


@pytest.fixture
def power(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Power:
    return Power(monkeypatch, tmp_path)


def test_job_resumes_at_the_exact_line_of_the_failure(power: Power, tmp_path: Path) -> None:
    """One write of a page, before 100 ms, records a stop without lost steps.

    The next start reports it, and the job resumed there ends where a whole run ends.
    """
    output = power.fails_in_job(233)
    assert "ALARM:36" in output and "ALARM:3" not in output
    assert len(power.writes) == 1 and power.writes[0] + _PAGE_MS < 100
    # It braked after the edge, and stood when the page was written.
    assert power.steps[0] != power.steps[-1] == power.steps[int(power.writes[0]) + 1]
    possible_lines = power.lines_with(power.steps[-1])

    # The supply is gone 100 ms after the edge.
    output = power.next_start(power.flash_after(100))
    parts = report(output)
    assert (
        parts["job"] == _JOB and parts["sure"] == _CERTAIN and int(parts["line"]) in possible_lines
    )
    assert position_mm(parts) == power.position_at(199)
    assert output.index(f"{_UNFINISHED}{parts['line']}]") == 1, "after the report of the failure"
    power.machine().put(_JOB, *_LINES)  # a next start
    output = power.bench.run(say(*HOMED, "$F=@", wait_s=20))
    assert not report(output), "a record is reported once"
    assert f"[MSG:Job {_JOB}: continues at line {parts['line']}]" in output
    whole_run = with_switches(Bench(tmp_path / "whole"))
    whole_run.folder.parent.mkdir()
    whole_run.put(_JOB, *_LINES)
    whole_run.run(until_job_ends(*FAST, *HOMED, f"$F={_JOB}"))
    assert whole_run.steps == power.bench.steps


@pytest.mark.parametrize(
    "after_ms", [pytest.param(n, marks=pytest.mark.thorough) for n in (97,)] + [311]
)
def test_cut_at_every_millisecond_leaves_the_record_or_the_journal(
    power: Power, after_ms: int
) -> None:
    """A cut while the page is written leaves the whole record or none.

    Without it, the job's stored record (the journal) still has the beginning of the job.
    """
    power.fails_in_job(after_ms)
    possible_lines = power.lines_with(power.steps[-1])
    (written_ms,) = power.writes
    for ms in range(120):
        image = power.flash_after(ms)
        # After the write nothing changes: every 20th is enough.
        if ms > written_ms + _PAGE_MS and ms % 20:
            assert image == power.flash_after(119)
            continue
        parts = report(power.next_start(image))
        assert not parts or ms > written_ms
        assert parts or ms < written_ms + _PAGE_MS
        if parts:
            assert int(parts["line"]) in possible_lines and position_mm(
                parts
            ) == power.position_at(119)
        else:
            assert power.store.files["job"][1] == "1", "the beginning, as noted before"


@pytest.mark.sampled(12, 60)
@pytest.mark.parametrize("after_ms", range(120, 620))
def test_failure_at_every_millisecond_of_a_job_is_recorded(power: Power, after_ms: int) -> None:
    """The record is written before 100 ms, with the position and the line of the stop."""
    power.fails_in_job(after_ms)
    (written_ms,) = power.writes
    possible_lines = power.lines_with(power.steps[-1])
    assert written_ms + _PAGE_MS < 100
    steps_when_written = power.steps[int(written_ms) + 1]
    assert steps_when_written == power.steps[-1], "nothing is written while a step may come"
    parts = report(power.next_start(power.flash_after(100)))
    assert parts["sure"] == _CERTAIN and position_mm(parts) == power.position_at(199)
    assert int(parts["line"]) in possible_lines


# Jobs whose lines take the main loop long; it waits in the line of the parameter `line`.
_WAITING = {
    "an arc of more chords than the ring has rows": (*["X-0.1"] * 20, "G2X-20I-10", "G1X-1"),
    "a dwell": ("X-1", "G4P1", "X-1"),
    "a word that waits for motion": ("X-1", "X-20", "M5", "X-1"),
}


@pytest.mark.parametrize(
    ("lines", "line", "ms"),
    list(zip(_WAITING.values(), (22, 3, 3), (400, 300, 300), strict=True)),
    ids=_WAITING,
)
def test_line_is_exact_while_the_loop_waits_in_a_line(
    power: Power, lines: "tuple[str, ...]", line: int, ms: int
) -> None:
    """The supply fails while the main loop waits in a line, and the record has that line.

    Lines are an arc too long for the planner, a dwell, or a word that waits for the end of motion.
    """
    # The parameter `line` is that in which it waits: line 1 has the modes.
    power.fails_in_job(ms, lines=("G21G91G1F3000", *lines))
    parts = report(power.next_start(power.flash_after(100)))
    assert parts["sure"] == _CERTAIN and int(parts["line"]) == line
    assert position_mm(parts) == power.position_at(199)


def test_motion_that_does_not_stop_in_time_is_stopped_at_once(power: Power) -> None:
    """At 60 mm/s2 braking takes longer than the supply lasts: at 85 ms motors stop at once."""
    power.fails_in_job(1500, "$120=60", "$121=60", "$122=60")
    (written_ms,) = power.writes
    assert 85 < written_ms < 97
    steps_before, last_steps = power.steps[80], power.steps[-1]
    assert steps_before != power.steps[85] != last_steps, "it was moving"
    line = max(power.lines_with(last_steps))
    parts = report(power.next_start(power.flash_after(100)))
    assert parts["sure"] == "stopped without braking, position uncertain"
    assert position_mm(parts) == power.position_at(199)
    lines_too_early = line - int(parts["line"])
    assert 0 <= lines_too_early <= 6


def test_z_goes_up_and_is_recorded_before_and_after(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """After the stop, the first record is written.

    Then Z moves up by 1 mm, and a second record has the new position. Until then, Z may be higher
    than recorded.
    """
    power = Power(monkeypatch, tmp_path, POWER_FAIL_UP_MM=1)
    power.fails_in_job(300)
    first_ms, second_ms = power.writes
    assert first_ms + _PAGE_MS < second_ms < 100 - _PAGE_MS
    up_mm = power.position_at(199)["Z"] - power.position_at(first_ms + 1)["Z"]
    assert round(up_mm, 3) == 1
    possible_lines = power.lines_with(power.steps[int(first_ms) + 1])
    for ms, certainty in (
        (first_ms + 4, "position certain, Z perhaps higher"),
        (second_ms + 4, _CERTAIN),
    ):
        position = power.position_at(first_ms + 1 if ms < second_ms else 199)
        parts = report(power.next_start(power.flash_after(ms)))
        assert parts["sure"] == certainty and int(parts["line"]) in possible_lines
        assert position_mm(parts) == position


def test_z_stays_where_it_is_not_homed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without homing, nothing is known of the space above Z."""
    power = Power(monkeypatch, tmp_path, POWER_FAIL_UP_MM=1)

    def script(bench: Bench) -> Iterator[Any]:
        yield from say(*FAST, "G1X9F3000", wait_s=0)(bench)
        yield bench.rig.ms(50)  # in motion
        yield from power.fail()

    power.bench.run(script)
    assert len(power.writes) == 1 and {steps[2] for steps in power.steps} == {0}


def test_supply_that_comes_back_leaves_a_machine_in_alarm(power: Power) -> None:
    """The supply fails twice in a job, and returns each time before the machine is off.

    After unlocking and homing, the job resumes at the reported line.
    """
    power.bench.put(_JOB, *_LINES)
    lines: list[set[int]] = []

    def script(bench: Bench) -> Iterator[Any]:
        """Twice let the supply fail and return in the job, and resume at the record."""
        yield from say(*FAST, *HOMED, f"$F={_JOB}", wait_s=0)(bench)
        for line in (20, 45):
            yield from bench.sender.until(lambda line=line: has_planned(bench, line))
            bench.sender.take()
            yield from power.fail(1000)
            lines.append(power.lines_with(power.steps[-1]))
            Pin(_PIN).drive(0)  # the supply is back
            yield bench.rig.ms(200)  # the alarm is reported
            output = bench.sender.take()
            assert "ALARM:36" in output
            parts = report(output)
            assert parts["sure"] == _CERTAIN and bench.job_record()[1] == parts["line"]
            assert int(parts["line"]) in lines[-1]
            yield from say("$X", "$H", "$F=@", wait_s=0)(bench)
        yield bench.rig.ms(10_000)  # the job ends

    assert power.bench.run(script)[-1].endswith("done, 61 lines]")
    # The job went on between both failures.
    assert lines[0].isdisjoint(lines[1])


def test_nothing_moves_while_the_contact_is_open(power: Power) -> None:
    """Also from power-up on, because the wire may be cut: each attempt ends in ALARM:36."""

    def script(bench: Bench) -> Iterator[Any]:
        """Try to move with an open contact, close it, and move."""
        Pin(_PIN).drive(1)  # open
        yield bench.rig.ms(1000)  # the alarm is reported
        assert "ALARM:36" in bench.sender.take()
        yield from say("$X", "G0X5", wait_s=3)(bench)
        assert "ALARM:36" in bench.sender.take()
        Pin(_PIN).drive(0)  # closed again
        yield from say("$X", "G0X1", wait_s=5)(bench)

    output = power.bench.run(script)
    # ALARM:16 would be an internal fault.
    assert power.bench.steps == [_STEPS_PER_MM, 0, 0] and "ALARM:16" not in output


def test_tool_does_not_turn_while_the_contact_is_open(power: Power) -> None:
    """M3 with an open contact is ALARM:36, like motion."""

    def script(bench: Bench) -> Iterator[Any]:
        """Open the contact, unlock, and try to start the spindle."""
        Pin(_PIN).drive(1)  # open
        yield bench.rig.ms(1000)  # the alarm is reported
        bench.sender.take()
        yield from say("$X", "M3S1000", wait_s=3)(bench)
        assert "ALARM:36" in bench.sender.take()
        assert bench.rig.port.spindle_pwm == 0

    power.bench.run(script)


@pytest.mark.parametrize("after_ms", [10, 30, 50])
def test_reset_is_answered_after_a_failure_while_backlash_is_taken_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, after_ms: int
) -> None:
    """X reverses, with 2 mm of slack. It stops in the slack, and nothing moves from then on."""
    power = Power(monkeypatch, tmp_path, BACKLASH=True)

    def script(bench: Bench) -> Iterator[Any]:
        """Begin to take up the slack, open the contact, and reset."""
        yield from say(*FAST, "$120=500", "$160=2", "G1X1F500", wait_s=3)(bench)
        bench.rig.link.send(b"G1X0\n")
        yield bench.rig.ms(after_ms)
        assert bench.rig.moving()
        yield from power.fail(1000)
        bench.sender.take()
        yield from bench.sender.wait("banner", "\x18")

    power.bench.run(script)
    assert power.steps[100] == power.steps[-1] == power.bench.steps
    assert power.bench.rig.controller.planner.axis_steps(power.bench.steps, 0) == _STEPS_PER_MM


# By state: a line to enter it, the line that is executed, and a real-time byte after it.
_STATES = {
    "idle": ("", "M5", ""),
    "running": ("", "G1X8F3000", ""),
    "in a dwell": ("", "G4P5", ""),
    "held": ("", "G1X8F3000", "!"),
    "jogging": ("", "$J=X8F3000", ""),
    "homing": ("", "$H", ""),
    "asleep": ("", "$SLP", ""),
    "in alarm": ("", "G1X8F3000", "\x18"),
    "in check mode": ("$C", "G1X8F3000", ""),
    "open": ("", "G1X8F3000", "\x84"),
    "probing": ("", "G38.2X8F3000", ""),
}


@pytest.mark.parametrize("state", _STATES)
def test_failure_stops_the_machine_in_every_state(power: Power, state: str) -> None:
    """_STATES has a line and a real-time byte by which each state is entered.

    A position that is lost or unknown is not recorded.
    """
    before, line, byte = _STATES[state]  # before: a line that comes first, "" is none

    def script(bench: Bench) -> Iterator[Any]:
        """Enter the state by line and byte, let the supply fail, and return 1 s later."""
        yield from say(*FAST, *HOMED[:-1], "$X", "M3S100", wait_s=0)(bench)
        bench.rig.link.send(f"{before}\n".encode() if before else b"")
        yield bench.rig.ms(50)
        bench.rig.link.send(f"{line}\n".encode())
        yield bench.rig.ms(60)
        bench.rig.link.send(byte.encode("latin-1"))
        yield bench.rig.ms(700 if byte else 1)  # until a byte has had its effect
        bench.sender.take()
        yield from power.fail(1000)
        assert not bench.rig.moving() and power.steps[100] == power.steps[-1]
        Pin(_PIN).drive(0)  # the supply is back
        yield bench.rig.ms(200)  # the alarm is reported

    output = power.bench.run(script)
    alarm = "ALARM:6" if state == "homing" else "ALARM:36"
    assert [text for text in output if text.startswith("ALARM:")] == [alarm], output
    is_recorded = state not in ("homing", "in alarm", "in check mode")
    assert bool(report(output)) == is_recorded
    if is_recorded:
        assert position_mm(report(output)) == power.position_at(999)


def test_time_of_a_stop_is_reported_for_the_settings(power: Power) -> None:
    """The time has three parts.

    These are 14 ms of steps already queued, the braking of the slowest axis, and 3 ms to write.
    """
    output = power.bench.run(say(*FAST, "$I", wait_s=0))
    # 14 + 50 + 3: FAST has 100 mm/s and 2000 mm/s2.
    assert "[MSG:Power fail: a stop takes 67 ms; the supply lasts 100 ms]" in output
    output = power.bench.run(say("$121=200", "$I", wait_s=0))
    assert "[MSG:Power fail: a stop takes 517 ms; the supply lasts 100 ms]" in output
    output = power.bench.run(say("$121=0", "$I", wait_s=0))
    # No acceleration counts as the longest stop that is represented, 1000 min.
    assert "[MSG:Power fail: a stop takes 60000017 ms; the supply lasts 100 ms]" in output


def test_board_whose_flash_has_no_page_says_so(
    power: Power, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a page there is no record, but the machine stops; the next start reports it."""
    monkeypatch.setattr(prepared_page, "flash_of_chip", lambda: None)
    output = power.fails_in_job(100)
    assert "ALARM:36" in output and power.writes == []
    Pin(_PIN).drive(0)  # the supply is back
    output = power.bench.run(say("$G", wait_s=0))
    assert output[0].startswith("[MSG:POWER_FAIL: no free page of flash")
