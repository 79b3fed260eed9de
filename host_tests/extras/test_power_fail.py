"""POWER_FAIL: the supply fails at any moment, and is gone at any later one.

The flash of the record is a littlefs image. A page takes 3 ms, the longest of the data sheet; a
cut in that time leaves a part of it.
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
from test_jobs import FAST, HOMED, Bench, homed, say, to_its_end

_PIN = 22
_PAGE_MS = 3
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
    """The supply of a machine with POWER_FAIL, and its flash."""

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path, **options: Any) -> None:
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
        """Return a machine that is powered now. image: the content of its flash."""
        if image is not None:
            self.flash = Flash(image)
        Pin.pins.pop(_PIN, None)
        Pin(_PIN).drive(0)
        files, device = Files(self.flash, fresh), BlockDevice(self.flash)
        device.on_write = lambda: self.writes.append(self._now_ms() - self._edge_ms)
        self._patch.setattr(prepared_page, "open", files.open, raising=False)
        self._patch.setattr(prepared_page, "os", files)
        self._patch.setattr(prepared_page, "flash_of_chip", lambda: device)
        self.bench = homed(Bench(self.folder, self.store, **self.options))
        self.store = self.bench.store
        return self.bench

    def _now_ms(self) -> float:
        return float(self.bench.rig.now / self.bench.rig.ticks_per_ms)

    def fail(self, lasts_ms: int = 200) -> Iterator[Any]:
        """Open the contact, an interrupt at any place of the firmware; then let time pass."""
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
        """Run a job, and let the supply fail so many ms after its beginning."""
        self.bench.put(_JOB, *lines)

        def script(bench: Bench) -> Iterator[Any]:
            yield from say(*FAST, *HOMED, *settings, f"$F={_JOB}", wait_s=0)(bench)
            yield from bench.sender.until(lambda: bench.kept() != [])
            bench.sender.take()
            yield bench.rig.ms(after_ms)
            yield from self.fail()

        return self.bench.run(script)

    def cut(self, after_ms: float) -> bytes:
        """Return the flash of a supply that was gone so many ms after the edge."""
        begun = sum(ms < after_ms for ms in self.writes)
        whole = sum(ms + _PAGE_MS <= after_ms for ms in self.writes)
        torn = 0
        if begun > whole:
            torn = int(PAGE * (after_ms - self.writes[whole]) / _PAGE_MS)
        return cut(self.image, self._log, whole, torn)

    def starts(self, image: bytes) -> "list[str]":
        """Return the messages of the next start with this flash, and the files of the edge."""
        self.store.files = copy.deepcopy(self.files)
        return self.machine(image=image).run(say("$G", wait_s=0))

    def at(self, ms: float) -> "dict[str, float]":
        """Return the position so many ms after the edge, as reports print it."""
        steps = self.steps[min(int(ms), len(self.steps) - 1)]
        return {axis: round(steps[i] / _STEPS_PER_MM, 3) for i, axis in enumerate("XYZ")}

    def line_at(self, steps: "list[int]") -> "set[int]":
        """Return the lines of the job on whose way these steps are."""
        found, start = set(), None
        for line, (_, _, target, _) in self.bench.log:
            if start and line:
                ends = zip(start, target, steps, strict=False)
                if all(
                    min(a, b) - 0.005 <= n / _STEPS_PER_MM <= max(a, b) + 0.005 for a, b, n in ends
                ):
                    found.add(line)
            start = target
        return found


def report(said: "list[str]") -> "dict[str, Any]":
    """Return the parts of the report; {} without one."""
    found = [match for match in map(_REPORT.match, said) if match]
    assert len(found) <= 1, said
    return found[0].groupdict() if found else {}


def has_planned(bench: Bench, line: int) -> bool:
    """Return whether that line of the job has been planned."""
    return any(entry[0] >= line for entry in bench.log)


def place(found: "dict[str, Any]") -> "dict[str, float]":
    return {axis: float(found[axis]) for axis in "XYZ"}


@pytest.fixture
def power(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Power:
    return Power(monkeypatch, tmp_path)


def test_job_resumes_at_the_exact_line_of_the_failure(power: Power, tmp_path: Path) -> None:
    said = power.fails_in_job(233)
    assert "ALARM:36" in said and "ALARM:3" not in said
    assert len(power.writes) == 1 and power.writes[0] + _PAGE_MS < 100
    assert power.steps[0] != power.steps[-1] == power.steps[int(power.writes[0]) + 1]
    lines = power.line_at(power.steps[-1])

    said = power.starts(power.cut(100))
    found = report(said)
    assert found["job"] == _JOB and found["sure"] == _CERTAIN and int(found["line"]) in lines
    assert place(found) == power.at(200)
    assert f"{_UNFINISHED}{found['line']}]" in said
    assert said.index(f"{_UNFINISHED}{found['line']}]") == 1
    power.machine().put(_JOB, *_LINES)
    said = power.bench.run(say(*HOMED, "$F=@", wait_s=20))
    assert not report(said), "a record is reported once"
    assert f"[MSG:Job {_JOB}: continues at line {found['line']}]" in said
    whole = homed(Bench(tmp_path / "whole"))
    whole.folder.parent.mkdir()
    whole.put(_JOB, *_LINES)
    whole.run(to_its_end(*FAST, *HOMED, f"$F={_JOB}"))
    assert whole.steps == power.bench.steps


@pytest.mark.parametrize(
    "after_ms", [pytest.param(n, marks=pytest.mark.thorough) for n in (97,)] + [311]
)
def test_cut_at_every_millisecond_leaves_the_record_or_the_journal(
    power: Power, after_ms: int
) -> None:
    power.fails_in_job(after_ms)
    lines = power.line_at(power.steps[-1])
    (written,) = power.writes
    for ms in range(120):
        image = power.cut(ms)
        if ms > written + _PAGE_MS and ms % 20:
            assert image == power.cut(119)
            continue
        found = report(power.starts(image))
        assert not found or ms > written
        assert found or ms < written + _PAGE_MS
        if found:
            assert int(found["line"]) in lines and place(found) == power.at(119)
        else:
            assert power.store.files["job"][1] == "1", "the beginning, as noted before"


@pytest.mark.sampled(12, 60)
@pytest.mark.parametrize("after_ms", range(120, 620))
def test_failure_at_every_millisecond_of_a_job_is_recorded(power: Power, after_ms: int) -> None:
    power.fails_in_job(after_ms)
    (written,) = power.writes
    lines = power.line_at(power.steps[-1])
    assert written + _PAGE_MS < 100
    still = power.steps[int(written) + 1]
    assert still == power.steps[-1], "nothing is written while a step may come"
    found = report(power.starts(power.cut(100)))
    assert found["sure"] == _CERTAIN and place(found) == power.at(199)
    assert int(found["line"]) in lines


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
    power.fails_in_job(ms, lines=("G21G91G1F3000", *lines))
    found = report(power.starts(power.cut(100)))
    assert found["sure"] == _CERTAIN and int(found["line"]) == line
    assert place(found) == power.at(199)


def test_motion_that_does_not_stop_in_time_is_stopped_at_once(power: Power) -> None:
    power.fails_in_job(1500, "$120=60", "$121=60", "$122=60")
    (written,) = power.writes
    assert 85 < written < 97
    before, at_end = power.steps[80], power.steps[-1]
    assert before != power.steps[85] != at_end, "it was moving"
    line = max(power.line_at(at_end))
    found = report(power.starts(power.cut(100)))
    assert found["sure"] == "stopped without braking, position uncertain"
    assert place(found) == power.at(199)
    assert 0 <= line - int(found["line"]) <= 6


def test_z_goes_up_and_is_recorded_before_and_after(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    power = Power(monkeypatch, tmp_path, POWER_FAIL_UP_MM=1)
    power.fails_in_job(300)
    first, second = power.writes
    assert first + _PAGE_MS < second < 100 - _PAGE_MS
    up = power.at(199)["Z"] - power.at(first + 1)["Z"]
    assert round(up, 3) == 1
    lines = power.line_at(power.steps[int(first) + 1])
    for ms, sure in ((first + 4, "position certain, Z perhaps higher"), (second + 4, _CERTAIN)):
        at = power.at(first + 1 if ms < second else 199)
        found = report(power.starts(power.cut(ms)))
        assert found["sure"] == sure and int(found["line"]) in lines
        assert place(found) == at


def test_z_stays_where_it_is_not_homed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    power = Power(monkeypatch, tmp_path, POWER_FAIL_UP_MM=1)

    def script(bench: Bench) -> Iterator[Any]:
        yield from say(*FAST, "G1X9F3000", wait_s=0)(bench)
        yield bench.rig.ms(50)
        yield from power.fail()

    power.bench.run(script)
    assert len(power.writes) == 1 and {steps[2] for steps in power.steps} == {0}


def test_supply_that_comes_back_leaves_a_machine_in_alarm(power: Power) -> None:
    power.bench.put(_JOB, *_LINES)
    lines: list[set[int]] = []

    def script(bench: Bench) -> Iterator[Any]:
        yield from say(*FAST, *HOMED, f"$F={_JOB}", wait_s=0)(bench)
        for reached in (20, 45):
            yield from bench.sender.until(lambda line=reached: has_planned(bench, line))
            bench.sender.take()
            yield from power.fail(1000)
            lines.append(power.line_at(power.steps[-1]))
            Pin(_PIN).drive(0)
            yield bench.rig.ms(200)
            said = bench.sender.take()
            assert "ALARM:36" in said
            found = report(said)
            assert found["sure"] == _CERTAIN and bench.kept()[1] == found["line"]
            assert int(found["line"]) in lines[-1]
            yield from say("$X", "$H", "$F=@", wait_s=0)(bench)
        yield bench.rig.ms(10_000)

    assert power.bench.run(script)[-1].endswith("done, 61 lines]")
    assert lines[0].isdisjoint(lines[1])


def test_nothing_moves_while_the_contact_is_open(power: Power) -> None:
    """Also from power-up on: the wire may be cut."""

    def script(bench: Bench) -> Iterator[Any]:
        Pin(_PIN).drive(1)
        yield bench.rig.ms(1000)
        assert "ALARM:36" in bench.sender.take()
        yield from say("$X", "G0X5", wait_s=3)(bench)
        assert "ALARM:36" in bench.sender.take()
        Pin(_PIN).drive(0)
        yield from say("$X", "G0X1", wait_s=5)(bench)

    said = power.bench.run(script)
    assert power.bench.steps == [_STEPS_PER_MM, 0, 0] and "ALARM:16" not in said


def test_tool_does_not_turn_while_the_contact_is_open(power: Power) -> None:
    def script(bench: Bench) -> Iterator[Any]:
        Pin(_PIN).drive(1)
        yield bench.rig.ms(1000)
        bench.sender.take()
        yield from say("$X", "M3S1000", wait_s=3)(bench)
        assert "ALARM:36" in bench.sender.take()
        assert bench.rig.port.spindle_pwm == 0

    power.bench.run(script)


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
    before, line, byte = _STATES[state]

    def script(bench: Bench) -> Iterator[Any]:
        yield from say(*FAST, *HOMED[:-1], "$X", "M3S100", wait_s=0)(bench)
        bench.rig.link.send(f"{before}\n".encode() if before else b"")
        yield bench.rig.ms(50)
        bench.rig.link.send(f"{line}\n".encode())
        yield bench.rig.ms(60)
        bench.rig.link.send(byte.encode("latin-1"))
        yield bench.rig.ms(700 if byte else 1)
        bench.sender.take()
        yield from power.fail(1000)
        assert not bench.rig.moving() and power.steps[100] == power.steps[-1]
        Pin(_PIN).drive(0)
        yield bench.rig.ms(200)

    said = power.bench.run(script)
    alarm = "ALARM:6" if state == "homing" else "ALARM:36"
    assert [text for text in said if text.startswith("ALARM:")] == [alarm], said
    is_recorded = state not in ("homing", "in alarm", "in check mode")
    assert bool(report(said)) == is_recorded
    if is_recorded:
        assert place(report(said)) == power.at(999)


def test_time_of_a_stop_is_reported_for_the_settings(power: Power) -> None:
    said = power.bench.run(say(*FAST, "$I", wait_s=0))
    assert "[MSG:Power fail: a stop takes 67 ms; the supply lasts 100 ms]" in said  # 14 + 50 + 3
    said = power.bench.run(say("$121=200", "$I", wait_s=0))
    assert "[MSG:Power fail: a stop takes 517 ms; the supply lasts 100 ms]" in said
    said = power.bench.run(say("$121=0", "$I", wait_s=0))
    assert "[MSG:Power fail: a stop takes 60000017 ms; the supply lasts 100 ms]" in said


def test_board_whose_flash_has_no_page_says_so(
    power: Power, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(prepared_page, "flash_of_chip", lambda: None)
    said = power.fails_in_job(100)
    assert "ALARM:36" in said and power.writes == []
    Pin(_PIN).drive(0)
    said = power.bench.run(say("$G", wait_s=0))
    assert said[0].startswith("[MSG:POWER_FAIL: no free page of flash")
