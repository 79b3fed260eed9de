"""Test `ugrbl doctor`: at the simulator, at ports with other devices, and its judgement.

A finding has a subject (what), a verdict (OK, NOTE or BAD), a text, and what to do (todo). The
command fails if one is BAD. Bench is a simulator as a process on a pseudo-terminal: bench.push()
presses a switch, bench.wire(">") returns the bytes sent to it, bench.stop() its motor steps."""

import json
import os
import threading
import time
import tty
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
from sim_bench import SETTINGS, STEPS_PER_MM, SWITCH_STEPS, Bench
from typer.testing import CliRunner
from ugrbl.cli import doctor, ports
from ugrbl.cli.app import app
from ugrbl.device import board_under_test, checkup, connection, settings_check
from ugrbl.device import settings_sync as sync
from ugrbl.device.checkup import BAD, NOTE, OK, Finding
from ugrbl.device.connection import Connection
from ugrbl.grbl.settings_file import Firmware

OLD_PICO = b"\r\n|rp2|Raspberry Pi Pico with RP2040|1.25.0|183000|False|\r\n>>> "
OURS = Firmware("1.1", "h", "20261121", "Grbl", "V,15,128")
GRBL = Firmware("1.1", "h", "20190830", "", "V,15,128")
# Settings of a machine without any finding.
GOOD: dict[int, float] = {
    **dict.fromkeys((5, 6, 13, 20, 31, 32), 0),
    **dict.fromkeys((21, 22), 1),
    **dict.fromkeys((100, 101, 102), 80),
    **dict.fromkeys((110, 111, 112), 6000),
    **dict.fromkeys((120, 121, 122), 400),
    **dict.fromkeys((130, 131, 132), 300),
    0: 10,
    11: 0.01,
    12: 0.002,
    24: 50,
    25: 800,
    27: 2,
    30: 1000,
}


def run_doctor(port: object, *words: str) -> Any:
    """Run the doctor; return exit code, findings by subject, and the verdict."""
    command = ["doctor", "--port", str(port), "--json", "-", *words]
    done = CliRunner().invoke(app, command)
    report = json.loads(done.stdout)
    by_name: dict[str, list[dict[str, str]]] = {}
    for row in report["findings"]:
        by_name.setdefault(row["what"], []).append(row)
    return done.exit_code, by_name, report["verdict"]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """Return a running simulator with factory settings, as fast as possible."""
    running = Bench(tmp_path, "--speed", "max")
    yield running
    running.kill()


# At the simulator


def test_machine_with_factory_settings_can_move_and_needs_settings(bench: Bench) -> None:
    """--move: move each axis a little; --pins 0: do not wait for switches to be pressed."""
    code, findings, verdict = run_doctor(bench.port, "--move", "--pins", "0")
    assert code == 0
    assert findings["port"][0]["verdict"] == OK
    assert findings["firmware"][0]["text"].startswith("Grbl 1.1h")
    assert findings["state"][0]["text"] == "Idle"
    assert "factory settings" in findings["settings"][0]["text"]
    assert [findings[f"move {letter}"][0]["verdict"] for letter in "XYZ"] == [OK] * 3
    assert "$3" in findings["move X"][0]["todo"]
    assert "worth a look" in verdict
    assert bench.stop() == [0, 0, 0]  # there and back


def test_nothing_moves_without_consent(bench: Bench) -> None:
    _, findings, _ = run_doctor(bench.port)
    assert not any(name.startswith("move") for name in findings)
    assert b"$J" not in bench.wire(">")


@pytest.mark.thorough
def test_pressed_switches_are_seen(bench: Bench) -> None:
    """--pins 5: the doctor watches the inputs for 5 s."""

    def press() -> None:
        """Press and release the switch of X, then the probe."""
        for pin in ("limit_x", "probe"):
            time.sleep(1.2)  # s: the doctor reads settings first, and sees each press once
            bench.push(pin)
            time.sleep(0.5)
            bench.push(pin, False)

    presser = threading.Thread(target=press)
    presser.start()
    code, findings, _ = run_doctor(bench.port, "--pins", "5", "--no-move")
    presser.join()
    assert code == 0
    assert findings["switches"][0]["text"] == "seen: limit switch X (1×), probe (1×)"


def test_input_active_while_idle_is_named_with_its_setting(tmp_path: Path) -> None:
    """The remedy inverts the input: $5 for limits, $6 for the probe."""
    bench = Bench(tmp_path, "--speed", "max", settings=SETTINGS)
    bench.push("limit_y")
    bench.push("probe")
    time.sleep(0.3)  # s: the simulator has read both
    code, findings, _ = run_doctor(bench.port, "--no-move", "--pins", "0")
    bench.kill()
    assert code == 1
    assert findings["limits"][0]["text"] == "limit inputs active at rest: Y"
    assert "$5=1" in findings["limits"][0]["todo"] and "$6=1" in findings["probe"][0]["todo"]


def test_locked_machine_is_reported_with_the_remedy_and_does_not_move(tmp_path: Path) -> None:
    """With stored settings but no stored offsets the simulator starts in an alarm."""
    bench = Bench(tmp_path, "--speed", "max", settings=SETTINGS)
    code, findings, _ = run_doctor(bench.port, "--move", "--pins", "0")
    bench.kill()
    assert code == 0
    assert findings["state"][0]["verdict"] == NOTE and "$H" in findings["state"][0]["todo"]
    assert findings["move X"][0]["text"] == "not tried: the machine is in Alarm"


def test_move_into_a_switch_is_reported_with_its_alarm(bench: Bench) -> None:
    """Hard limits are on; X is moved to half a millimetre before its switch."""
    connection = sync.connect(str(bench.port))
    near_mm = SWITCH_STEPS / STEPS_PER_MM - 0.5
    for line in ("$21=1", f"$J=G91 X{near_mm} F500"):
        assert connection.ask(line)[-1] == "ok"
    connection.wait_for(lambda line: f"<Idle|MPos:{near_mm:.3f}" in line, 20)
    connection.close()
    code, findings, _ = run_doctor(bench.port, "--move", "--pins", "0")
    assert code == 1
    assert findings["move X"][0]["text"].startswith("ALARM:1: ")
    assert "move Y" not in findings


# At ports with other devices


class OtherDevice(threading.Thread):
    """A device that is not our firmware.

    answers: what it sends if these bytes are received; always: what it sends every 20 ms."""

    def __init__(self, answers: dict[bytes, bytes], always: bytes = b"") -> None:
        super().__init__(daemon=True)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._answers = answers
        self._always = always
        self.stopped = threading.Event()

    def run(self) -> None:
        """Every 20 ms: read, send the answers to what was read, and what is always sent."""
        while not self.stopped.wait(0.02):
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                continue
            for part, answer in self._answers.items():
                if part in data:
                    os.write(self._master, answer)
            os.write(self._master, self._always)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait long for a prompt."""
    monkeypatch.setattr(board_under_test, "_REPL_S", 0.3)


@pytest.mark.parametrize(
    ("answers", "always", "what", "text"),
    [
        ({}, b"", "firmware", "no answer"),
        (
            {
                b"\x03": b"\r\n>>> ",
                b"import": b"\r\n|rp2|Raspberry Pi Pico|1.28.0|183000|False|\r\n>>> ",
            },
            b"",
            "board",
            "Raspberry Pi Pico, MicroPython 1.28.0",
        ),
        (
            {b"\x03": b"\r\n>>> ", b"import": OLD_PICO},
            b"",
            "MicroPython",
            "MicroPython 1.25 is too old: ENGINE pio on RP2040 needs 1.26",
        ),
        ({b"\x03": b"\r\n>>> "}, b"", "firmware", "MicroPython shows its prompt; no Grbl runs"),
        ({}, b"rst:0x3 (SW_RESET)\r\n", "firmware", "an ESP32 that starts over and over"),
        ({}, b"echo:Marlin 2.1\r\n", "firmware", "Marlin"),
        ({}, b"\xff\xfe\x80\x9c\xe0", "firmware", "the board sends bytes that are no text"),
    ],
)
def test_other_device_is_reported(
    monkeypatch: pytest.MonkeyPatch,
    answers: dict[bytes, bytes],
    always: bytes,
    what: str,
    text: str,
) -> None:
    """The device sends `always` all the time, and answers after Ctrl-C (the prompt >>>) or to
    the doctor's `import` line (chip, name, version, free bytes, whether main.py has ended). The
    finding `what` contains the text."""
    monkeypatch.setattr(connection, "_START_S", 0.5)  # s to wait for a Grbl
    device = OtherDevice(answers, always)
    device.start()
    code, findings, _ = run_doctor(device.port)
    device.stopped.set()
    device.join()
    assert code == 1
    assert text in findings[what][0]["text"]
    assert findings["firmware"][0]["todo"]


def test_board_at_its_prompt_is_reported_with_its_free_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The answer has chip, name, version, free bytes, and whether main.py has ended."""
    monkeypatch.setattr(connection, "_START_S", 0.5)
    answer = b"\r\n|rp2|Raspberry Pi Pico|1.28.0|183000|True|\r\n>>> "
    device = OtherDevice({b"\x03": b"\r\n>>> ", b"import": answer})
    device.start()
    _, findings, _ = run_doctor(device.port)
    device.stopped.set()
    device.join()
    assert findings["memory"][0]["text"] == "178 kB are free"  # 183000 / 1024
    assert "main.py has ended" in findings["firmware"][0]["todo"]


def test_slow_ctrl_x_is_reported() -> None:
    """The name in the build information says slow-reset; another Grbl's name means nothing."""
    (finding,) = checkup.link(replace(OURS, name="Grbl pio 100000Hz slow-reset SHED"))
    assert finding.verdict == NOTE and "Ctrl-X" in finding.text and "1.28" in finding.todo
    assert checkup.link(replace(OURS, name="Grbl pio 100000Hz SHED")) == []
    assert checkup.link(replace(GRBL, name="slow-reset")) == []


@pytest.mark.parametrize(("used", "verdict"), [(4704, OK), (7168, OK), (7169, NOTE), (8192, NOTE)])
def test_nearly_full_c_stack_is_reported_with_the_next_step(used: int, verdict: str) -> None:
    """7168 is 7/8 of 8192 bytes."""
    replies = ["[VER:1.1h.20261121:]", f"[MSG:Stack: {used} of 8192 bytes used]", "ok"]
    (finding,) = checkup.stack(replies)
    assert finding.verdict == verdict and f"{used} of 8192 bytes" in finding.text
    assert ("report this" in finding.todo) == (verdict == NOTE)


def test_board_without_a_stack_figure_gets_no_row() -> None:
    assert checkup.stack(["error:3"]) == []
    assert checkup.stack(["[VER:1.1h.20261121:]", "[MSG:Stack: ]", "ok"]) == []


@pytest.mark.parametrize(
    ("count", "verdict", "words"),
    [
        ("0", OK, "no program stopped"),
        ("1", NOTE, "motion stopped once"),
        ("12", NOTE, "motion stopped 12 times"),
    ],
)
def test_underruns_of_programs_are_reported_with_the_next_step(
    count: str, verdict: str, words: str
) -> None:
    """The firmware counts underruns (Drains): motion stopped because the sender was too slow."""
    (finding,) = checkup.drains(["[VER:1.1h.20261121:]", f"[MSG:Drains: {count}]", "ok"])
    assert finding.verdict == verdict and words in finding.text
    assert ("ugrbl run" in finding.todo) == (verdict == NOTE)
    assert checkup.drains(["[VER:1.1h.20261121:]", "ok"]) == []


class RecordingConnection:
    """A connection that records its requests and gives these replies."""

    def __init__(self, *replies: str) -> None:
        self.lines: list[str] = []
        self._replies = list(replies)

    def ask(self, line: str) -> list[str]:
        self.lines.append(line)
        return self._replies


def test_only_our_firmware_is_asked_for_its_stack() -> None:
    """$I+ is our own request; another Grbl would refuse it."""
    replies = ["[MSG:Stack: 4704 of 8192 bytes used]", "ok"]
    ours, other = RecordingConnection(*replies), RecordingConnection("error:3")
    assert doctor._health(cast("Any", ours), OURS) == replies and ours.lines == ["$I+"]
    assert doctor._health(cast("Any", other), GRBL) == [] and other.lines == []


def test_stack_figure_of_a_board_gets_a_row(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulator has no such figure; then $I+ is answered as by a board."""
    code, findings, _ = run_doctor(bench.port, "--no-move", "--pins", "0")
    assert code == 0 and "C stack" not in findings
    ask = Connection.ask

    def with_stack(self: Connection, line: str) -> list[str]:
        replies = ["[MSG:Stack: 7700 of 8192 bytes used]", "ok"]
        return replies if line == "$I+" else ask(self, line)

    monkeypatch.setattr(Connection, "ask", with_stack)
    code, findings, verdict = run_doctor(bench.port, "--no-move", "--pins", "0")
    assert code == 0 and findings["C stack"][0]["verdict"] == NOTE and "worth a look" in verdict


# A fault of the firmware


@pytest.fixture
def fault() -> str:
    """Return a fault message as this version of the firmware sends it."""
    return '[MSG:IndexErr: list index File "talk.report", line 31, in status (01234567)]'


_REPORT = b"<Alarm|MPos:0.000,0.000,0.000|FS:0,0>\r\n"


def test_board_in_a_fault_alarm_is_asked_for_the_fault(fault: str) -> None:
    """It answers only reports and "$"."""
    device = OtherDevice({b"?": _REPORT, b"$": fault.encode() + b"\r\n"})
    device.start()
    code, findings, _ = run_doctor(device.port)
    device.stopped.set()
    assert code == 1 and "firmware" not in findings  # it answers nothing else
    assert 'list index File "talk.report", line 31, in status' in findings["fault"][0]["text"]
    assert "Ctrl-X" in findings["fault"][0]["todo"]


def test_board_that_cannot_start_reports_the_cause_by_name(fault: str) -> None:
    device = OtherDevice({}, fault.encode() + b"\r\n")
    (finding,) = findings_about(device)
    assert finding.what == "fault" and "talk.report" in finding.text


def findings_about(device: OtherDevice) -> "list[Finding]":
    """Return the findings about a device that is not a Grbl."""
    device.start()
    findings = board_under_test.stranger(device.port)
    device.stopped.set()
    return findings


def test_last_fault_is_reported_after_the_machine_works_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    """The firmware keeps its last fault, and reports it in the answer to $I+."""
    ask = Connection.ask

    def with_fault(self: Connection, line: str) -> list[str]:
        replies = [fault.replace("[MSG:", "[MSG:Last fault: "), "ok"]
        return replies if line == "$I+" else ask(self, line)

    monkeypatch.setattr(Connection, "ask", with_fault)
    code, findings, _ = run_doctor(bench.port, "--no-move", "--pins", "0")
    assert code == 1 and findings["state"][0]["text"] == "Idle"
    assert findings["fault"][0]["text"].startswith("[MSG:Last fault: IndexError: list index")


def test_alarm_without_a_fault_is_not_reported_as_one(tmp_path: Path) -> None:
    bench = Bench(tmp_path, "--speed", "max", settings=SETTINGS)
    connection = sync.connect(str(bench.port))
    assert connection.state() == "Alarm" and board_under_test.fault(connection) == ""
    connection.close()
    bench.kill()


def test_missing_port_is_named() -> None:
    code, findings, verdict = run_doctor("/dev/nowhere")
    assert code == 1 and verdict == "1 wrong"
    assert "/dev/nowhere" in findings["port"][0]["text"] and "cable" in findings["port"][0]["text"]


def test_only_port_is_chosen_and_none_of_several(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ports without USB numbers are not controllers."""

    class Usb:
        def __init__(self, device: str, vid: int | None, pid: int | None) -> None:
            self.device, self.vid, self.pid = device, vid, pid

    plugged = [Usb("/dev/ttyS0", None, None), Usb("/dev/ttyACM0", 0x2E8A, 5)]
    monkeypatch.setattr(ports.list_ports, "comports", lambda: plugged)
    assert ports.choose(None) == "/dev/ttyACM0"
    assert ports.find()[0].what == "Raspberry Pi Pico with MicroPython"
    plugged.append(Usb("/dev/ttyUSB0", 0x1A86, 0x7523))
    with pytest.raises(Exception, match=r"there are several: .*ttyACM0.*ttyUSB0"):
        ports.choose(None)
    plugged.clear()
    with pytest.raises(Exception, match="no controller was found"):
        ports.choose(None)


# The judgement


def not_ok(findings: list[Finding]) -> list[tuple[str, str]]:
    """Return subject and verdict of all findings that are not OK."""
    return [(finding.what, finding.verdict) for finding in findings if finding.verdict != OK]


def test_good_settings_have_no_finding() -> None:
    assert not_ok(settings_check.settings(GOOD, OURS)) == []


@pytest.mark.parametrize(
    ("values", "what", "verdict", "says"),
    [
        ({100: 0}, "settings", BAD, "$100"),
        ({130: 0}, "settings", BAD, "$130"),
        ({110: 60000, 100: 800}, "step rate", BAD, "lower $110 to"),
        ({0: 200}, "step rate", BAD, "pulses of 200 us"),
        ({121: 10}, "acceleration", NOTE, "raise"),
        ({121: 40}, "acceleration", NOTE, "takes 2.5 s"),
        ({27: 0}, "homing", BAD, "ALARM:8"),
        ({27: 400}, "homing", BAD, "longer than the travel of X"),
        ({24: 900}, "homing", NOTE, "slower"),
        ({21: 0}, "homing", NOTE, "$21"),
        ({22: 0, 20: 1}, "homing", BAD, "$22=1"),
        ({30: 0}, "spindle", BAD, "$30"),
        ({32: 1}, "spindle", NOTE, "laser"),
        ({11: 3}, "settings", NOTE, "$11"),
        ({12: 1}, "settings", NOTE, "$12"),
        ({13: 1}, "settings", NOTE, "inches"),
    ],
)
def test_bad_settings_are_reported_with_the_remedy(
    values: dict[int, float], what: str, verdict: str, says: str
) -> None:
    """values: settings that differ from the good ones."""
    findings = settings_check.settings({**GOOD, **values}, OURS)
    matching = [
        finding for finding in findings if (finding.what, finding.verdict) == (what, verdict)
    ]
    assert matching and all(finding.todo for finding in matching)
    assert says in " ".join(finding.text + finding.todo for finding in matching)


def test_real_grbl_has_a_lower_step_limit() -> None:
    fast = {**GOOD, 110: 30000.0}  # mm/min * 80 steps/mm: 40 kHz
    assert ("step rate", BAD) in not_ok(settings_check.settings(fast, GRBL))
    assert ("step rate", BAD) not in not_ok(settings_check.settings(fast, OURS))


@pytest.mark.parametrize(
    ("name", "most_hz"),
    [
        ("Grbl", 90_909),
        ("Grbl pio", 90_909),
        ("Grbl sim 5000", 90_909),
        ("Grbl rmt", 5000),
        ("Grbl rmt 5000Hz", 5000),
        ("Grbl rmt 20000Hz my 7000Hz mill", 20_000),
        ("Grbl i2s 41666Hz", 41_666),
        ("my mill", 30_000),
    ],
)
def test_step_limit_depends_on_the_pulse_engine(name: str, most_hz: int) -> None:
    """The name in the build information begins with the engine and its rate. Pulses last 10 us:
    10 us high and 1 us low are 90909 Hz."""
    firmware = Firmware("1.1", "h", "20261121", name, "V,15,128")
    assert int(settings_check.most_hz(firmware, 10)) == most_hz


def test_short_pulses_allow_the_highest_rate_of_the_engine() -> None:
    """Pulses of 3 us, at the end of 1 us."""
    names = {"Grbl pio": 250_000, "Grbl sim": 100_000, "Grbl rmt": 5000}
    for name, most_hz in names.items():
        assert settings_check.most_hz(replace(OURS, name=name), 3) == most_hz
    assert settings_check.most_hz(replace(OURS, name="Grbl pio"), 1) == 500_000


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (OURS, OK),
        (GRBL, OK),
        (Firmware("0.9", "j", "20160303", ""), BAD),
        (Firmware("1.1", "f", "20210101", "grblHAL"), NOTE),
        (Firmware("1.1", "h", "20250101", "Grbl"), NOTE),
        (Firmware(), BAD),
    ],
)
def test_versions_are_judged(found: Firmware, verdict: str) -> None:
    assert checkup.firmware(found, "20261121").verdict == verdict


def test_switch_needed_for_homing_but_never_seen_is_reported() -> None:
    """Changes seen at each switch of a machine with 3 axes."""
    findings = checkup.pins_pressed({"X": 1, "Y": 12}, GOOD, 3)
    assert [finding.text for finding in findings[1:]] == [
        "never seen, though homing ($22) needs them: Z",
        "Y changed very often",
    ]
    assert checkup.pins_pressed({}, GOOD, 3)[0].verdict == NOTE
