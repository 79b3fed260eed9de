"""Test that failures and unusual code in custom.py do no harm and come to an end.

bench(text) is a machine with this custom.py. cnc.say() powers it up and sends texts, each with
what to wait for: "ok" (an answer), "idle", "banner" or "ms 100" (100 ms); it returns the replies
to each text. lines() are texts that wait for "ok". Then cnc.heard has what handlers have added to
their list `heard`, cnc.mm the motors' position, cnc.greeting the lines at power-up.
"""

import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from base import errors
from base import state as st
from boot import power_up
from micropython_runner import needs_micropython, placed_firmware, run_micropython
from test_custom import Bench, lines
from typer.testing import CliRunner
from ugrbl.cli.app import app

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(4)

Make = Callable[[str], Bench]

_count = count()
_REFUSED = f"error:{errors.INVALID_STATEMENT}"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Return a maker of benches, each with a module of its own name."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))

    def make(text: str) -> Bench:
        head = "import sys\nfrom ugrbl import mcode, gcode, on, every, Refuse\nheard = []\n"
        return Bench(tmp_path, f"custom_faults_{next(_count)}", head + text)

    return make


def tool_length_line(replies: "list[str]") -> str:
    """Return the line with the tool length, such as [TLO:12.500], of the replies to $#."""
    return next(line for line in replies if line.startswith("[TLO:"))


# Check mode

_LENGTH = """
@mcode(99)
def measure(m): m.set_length(12.5)
@on.after_reset
def restore(m): m.set_length(12.5); heard.append(m.state)
"""


@pytest.mark.parametrize("leave", ["$C\n", "\x18"])
def test_tool_length_is_restored_after_check_mode(bench: Make, leave: str) -> None:
    """M99 sets a length. Check mode ends with a reset, which clears it; a handler restores it."""
    cnc = bench(_LENGTH)
    replies = cnc.say(*lines("M99", "$C", "G1X1F500"), (leave, "ms 300"), *lines("$#", "G0X1"))
    assert tool_length_line(replies[4]) == "[TLO:12.500]" and replies[5] == ["ok"]
    assert cnc.heard == ["Idle"]


def test_tool_length_is_valid_for_the_first_line_after_check_mode(bench: Make) -> None:
    cnc = bench(_LENGTH)
    replies = cnc.say(*lines("$C"), ("$C\n", "banner"), ("$#\n", "ok"))
    assert tool_length_line(replies[2]) == "[TLO:12.500]"


def test_no_handler_runs_in_check_mode(bench: Make) -> None:
    """Timers, inputs, states, reports, T and M words: all wait until check mode has ended."""
    cnc = bench(
        """
@every(20)
def tick(m): heard.append("tick"); m.out("vacuum", 1)
@on.input("sensor")
def sensor(m, closed): heard.append(closed)
@on.state_change
def change(m, was, now): heard.append(now)
@on.report
def field(m): heard.append("report"); return "Tk:1"
@on.tool_select
def select(m, tool): heard.append(tool)
@mcode(100)
def tool(m): heard.append(m.tool)
"""
    )
    modules: Any = sys.modules
    in_check_mode: list[Any] = []

    def forget() -> None:
        modules[cnc._name].heard.clear()

    def note_heard() -> None:
        in_check_mode.extend(cnc.heard)

    def close_sensor() -> None:
        cnc.rig.port.push({"pin_22": True})

    cnc.say(
        *lines("$C"),
        forget,
        close_sensor,
        *lines("T7", "M3S100", "M100"),
        ("?", "ms 500"),
        note_heard,
        ("$C\n", "ms 300"),
        *lines("M100"),
    )
    assert in_check_mode == []
    assert True in cnc.heard, "changes are reported after check mode"
    assert cnc.heard[-1] != 7 and 0 in cnc.heard, "no tool has been selected"


# After a welcome


@pytest.mark.parametrize(
    "body", ["m.g('G21 G90')", "1 / 0", "m.stop('no')", "m.home()", "raise Refuse('no')"]
)
@pytest.mark.parametrize("events", ["@on.after_reset", "@on.startup\n@on.after_reset"])
def test_failure_after_a_reset_is_one_alarm_and_the_machine_can_be_unlocked(
    bench: Make, body: str, events: str
) -> None:
    """The handler fails at power-up, and again after a reset during motion.

    body: statement of the handler; events: those that call it.
    """
    cnc = bench(f"{events}\ndef a(m): {body}")
    replies = cnc.say(
        ("", "ms 2000"),
        *lines("$22=0", "$X"),
        ("G1X9F500\n", "ms 500"),
        ("\x18", "ms 3000"),
        ("?", "ms 50"),
        *lines("$X", "G0X0"),
    )
    at_start = (cnc.greeting + replies[0]).count("ALARM:34")
    after_reset = replies[4].count("ALARM:34")
    # after_reset is not called at power-up. m.g() works there, but not in the alarm of a reset.
    assert at_start == ("startup" in events and "m.g" not in body)
    assert after_reset == ("stop" not in body), "m.stop() does no more in alarm"
    assert replies[5][0].startswith("<Alarm") and replies[6][-1] == replies[7][0] == "ok"


def test_failing_homing_after_a_reset_is_not_repeated(bench: Make) -> None:
    """No limit switch closes: homing fails with one alarm, and $X makes the machine idle."""
    cnc = bench("@on.after_reset\ndef a(m): heard.append(1); m.home()")
    replies = cnc.say(
        *lines("$22=1", "$X"),
        ("\x18", "ms 120000"),  # enough for homing to search all its travel
        ("?", "ms 50"),
        ("$X\n", "ok"),
        ("?", "ms 50"),
    )
    assert len([line for line in replies[2] if line.startswith("ALARM")]) == 1  # after the reset
    assert replies[3][0].startswith("<Alarm") and replies[5][0].startswith("<Idle")
    assert cnc.heard == [1]


def test_other_handlers_after_a_reset_still_run(bench: Make) -> None:
    """The first handler fails: in the alarm after a reset during motion, m.g() is not allowed."""
    cnc = bench(
        "@on.after_reset\ndef a(m): heard.append('a'); m.g('G21')\n"
        "@on.after_reset\ndef b(m): heard.append('b')\n"
    )
    cnc.say(("G1X9F500\n", "ms 500"), ("\x18", "ms 3000"))
    assert cnc.heard == ["a", "b"]


def test_handler_that_failed_after_a_reset_runs_again_after_the_next(bench: Make) -> None:
    """It fails only the first time; two resets while idle call it twice."""
    cnc = bench(
        "@on.after_reset\ndef a(m):\n    heard.append(m.state)\n    if len(heard) < 2: 1 / 0\n"
    )
    cnc.say(("\x18", "ms 2000"), *lines("$X"), ("\x18", "ms 500"))
    assert cnc.heard == ["Idle", "Idle"]


def test_second_reset_during_an_after_reset_handler_runs_it_again(bench: Make) -> None:
    cnc = bench("@on.after_reset\ndef a(m): heard.append(m.state); m.wait(1)")
    cnc.say(("\x18", "ms 300"), ("\x18", "ms 3000"))
    assert cnc.heard == ["Idle", "Idle"]


# sys.exit()


@pytest.mark.parametrize("way", ["sys.exit()", "raise SystemExit", "raise BaseException('x')"])
@pytest.mark.parametrize("event", ["@mcode(100)", "@every(20)", "@mcode(100, '', False)"])
def test_sys_exit_in_a_handler_is_a_failure_like_others(bench: Make, way: str, event: str) -> None:
    """Alarm with the file's name, everything off; the machine works after $X.

    way: statement that raises; event: decorator of its handler.
    """
    cnc = bench(f"@mcode(1000)\ndef on_(m): m.out('vacuum', 1)\n{event}\ndef a(m):\n    {way}")
    replies = cnc.say(("M3S500\nM100\n", "ms 3000"), *lines("$X"), ("G0X1\n", "idle"))
    received = cnc.greeting + replies[0]
    assert "ALARM:34" in received and any("custom_faults" in line for line in received)
    assert not cnc.power and cnc.outputs == 0 and replies[-1] == ["ok"] and cnc.mm[0] == 1


@pytest.mark.parametrize("way", ["sys.exit()", "raise BaseException('x')"])
def test_sys_exit_at_import_leaves_the_machine_without_custom_words(bench: Make, way: str) -> None:
    cnc = bench(f"@mcode(100)\ndef a(m): pass\n{way}")
    replies = cnc.say(*lines("M100", "G0X1"))
    assert any(line.startswith("[MSG:Custom left out: ") for line in cnc.greeting)
    assert replies == [["error:20"], ["ok"]]


def test_sys_exit_anywhere_stops_the_motors_and_is_an_alarm() -> None:
    """power_up.run_machine() with fakes that record calls: the main loop raises SystemExit.

    The outputs must be safe and the motors stopped before the alarm is sent.
    """
    calls: list[str] = []
    # The second one ends run_machine(), which would otherwise run the main loop for ever.
    raised: Iterator[BaseException] = iter([SystemExit(), KeyboardInterrupt()])

    def run() -> None:
        raise next(raised)

    def note(what: str) -> "Callable[..., None]":
        return lambda *_: calls.append(what)

    wire = SimpleNamespace(
        write=lambda data: calls.append(bytes(data).decode().split(" ")[0]),
        close=note("close"),
        read_into=lambda buf: buf.__setitem__(0, 0x18) or 1,  # one byte: a reset
    )
    machine = SimpleNamespace(
        power_up=note("up"),
        protocol=SimpleNamespace(run=run),
        state=st.State(),
        commands=SimpleNamespace(fault=""),
    )
    port = SimpleNamespace(safe=note("safe"), watch=note("watch"))
    watch = SimpleNamespace(end_absence=lambda: False, close=note("unwatch"))
    parts: Any = (machine, wire, port, SimpleNamespace(stop=note("stop")), watch, [])
    power_up.run_machine(parts)
    assert calls[:3] == ["up", "safe", "stop"]
    # write() has recorded the first word of each text sent.
    assert calls[3] == f"ALARM:{errors.ALARM_INTERNAL}\r\n" and calls[4] == "[MSG:SystemExit"


# Reports


@pytest.mark.parametrize(
    ("returned", "field"),
    [
        ("5", "|5>"),
        ("'Tk:1>\\r\\nok'", "|Tk:1   o-k>"),
        ("'<Idle|Tk:[2]'", "| Idle|Tk: 2 >"),
        ("None", ""),
        ("['a']", ""),
        ("object()", ""),
        ("''", ""),
    ],
)
def test_report_stays_one_line_for_any_returned_value(
    bench: Make, returned: str, field: str
) -> None:
    """Characters that would end the report or look like an answer are replaced.

    field: the end of the report; "": no field is added.
    """
    cnc = bench(f"@on.report\ndef r(m): return {returned}")
    replies = cnc.say(("?", "ms 50"), ("?", "ms 50"), *lines("G0X1"))
    assert len(replies[1]) == 1 and replies[1][0].endswith(field or ">") and replies[2] == ["ok"]
    # Without a field, at most three | are there; |Ov: is a further one, in some reports only.
    assert ("|Ov:" in replies[1][0]) or field or replies[1][0].count("|") <= 3


# Persistent values


_KEEP = """
@mcode(100)
def a(m): m.keep["a"] = 1
@mcode(101)
def b(m): m.keep[{name}] = {value}
@mcode(102)
def c(m): heard.append((m.keep.get("a"), m.keep.get("v")))
"""


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("'v'", "float('nan')", "v is not finite"),
        ("'v'", "-float('inf')", "v is not finite"),
        ("(1, 2)", "3", "the name (1, 2) must be a text"),
        ("7", "3", "the name 7 must be a text"),
    ],
)
def test_value_that_could_not_be_read_back_is_not_stored(
    bench: Make, name: str, value: str, reason: str
) -> None:
    """M101 stores the bad value and fails. M102 reads both values: only M100's is there."""
    cnc = bench(_KEEP.format(name=name, value=value))
    replies = cnc.say(*lines("M100"), ("M101\n", "ms 2000"), *lines("$X", "M102"))
    assert any(reason in line for line in replies[1]) and cnc.heard == [(1, None)]
    assert cnc.rig.store.files["keep"] == ['["a", 1]']


def test_true_is_stored_as_1(bench: Make) -> None:
    cnc = bench(_KEEP.format(name="'v'", value="True"))
    cnc.say(*lines("M101", "M102"), ("", "ms 50"))
    assert cnc.rig.store.files["keep"] == ['["v", 1]']


def test_damaged_stored_value_does_not_affect_others(bench: Make) -> None:
    """Of six stored lines two are sound. They are read, and the others are dropped at a write."""
    cnc = bench(_KEEP.format(name="'v'", value="2"))
    stored = ['["v", nan]', "5", '[["x"], 3]', '["u"', '["a", 8]', '["w", 9]']
    cnc.rig.store.files["keep"] = stored
    cnc.say(*lines("M102", "M102", "M101"), ("", "ms 50"))
    assert cnc.heard == [(8, None), (8, None)]
    assert cnc.rig.store.files["keep"] == ['["a", 8]', '["w", 9]', '["v", 2]']


# Words left out


def test_word_during_motion_that_was_left_out_is_refused(bench: Make) -> None:
    """A word with sync=False runs during motion, where a handler that has failed is disabled.

    A later M62 is refused, because its sender would take "ok" for done.
    """
    cnc = bench(
        "@mcode(62, 'P', sync=False)\ndef a(m, P):\n    if P == 5: 1 / 0\n    m.out('vacuum', P)\n"
    )
    replies = cnc.say(("M62P5\n", "ms 2000"), *lines("$X", "M62P1"))
    assert "ALARM:34" in replies[0]
    assert replies[2] == ["[MSG:M62 is disabled until power-up]", _REFUSED] and cnc.outputs == 0


def test_word_whose_timer_failed_still_works(bench: Make) -> None:
    """One function is both timer and M100. As a timer it fails: a timer may not move."""
    cnc = bench(
        "@every(20)\n@mcode(100)\n"
        "def a(m):\n    m.g('G91 G0 X3')\n    heard.append(m.target().x)\n"
    )
    replies = cnc.say(("", "ms 2000"), *lines("$X", "M100"))
    assert "ALARM:34" in cnc.greeting + replies[0]
    assert replies[2] == ["ok"] and cnc.heard == [3.0]


@pytest.mark.parametrize(
    "text",
    [
        "@mcode(6)\ndef a(m): pass\n@on.tool_change\ndef b(m, tool): heard.append(tool)",
        "@gcode(81)\ndef a(m): pass\n@gcode('81')\ndef b(m): pass",
        "@gcode(81)\ndef a(m): pass\n@gcode(81.0)\ndef b(m): pass",
        "@mcode(100)\ndef a(m): pass\n@mcode(101, ['P', 'q'])\ndef b(m, P): pass",
        "@mcode(100)\ndef a(m): pass\n@mcode('x')\ndef b(m, P): pass",
        "@mcode(100)\ndef a(m): pass\n@mcode\ndef b(m): pass",
        "@mcode(100)\ndef a(m): pass\n@gcode\ndef b(m): pass",
        "@mcode(100)\ndef a(m): pass\n@every\ndef b(m): pass",
        "@mcode(100)\ndef a(m): pass\n@on.input\ndef b(m, closed): pass",
        "@mcode(100)\ndef a(m): pass\n@mcode(101, sync=0)\ndef b(m): pass",
        "@mcode(100)\ndef a(m): pass\n@mcode(101, sync='no')\ndef b(m): pass",
    ],
)
def test_file_with_one_mistake_is_left_out_completely(bench: Make, text: str) -> None:
    """None of the file's words and events is active, not even those without a mistake."""
    others = (
        "@on.spindle\ndef s(m, *_): heard.append('s')\n@every(20)\ndef e(m): heard.append(1)\n"
    )
    cnc = bench(others + text)
    replies = cnc.say(*lines("M100", "G81", "M101", "M6", "M3S100"), ("", "ms 100"))
    assert [answer[-1] for answer in replies[:4]] == ["error:20"] * 4
    assert len([line for line in cnc.greeting if "Custom left out: " in line]) == 1
    assert cnc._name not in sys.modules or cnc.heard == []


def test_missing_parentheses_are_reported_with_the_right_form(bench: Make) -> None:
    cnc = bench("@mcode\ndef a(m): pass\n@mcode(100)\ndef b(m): pass")
    cnc.say(*lines("G0X1"))
    assert any("write @mcode(100)" in line for line in cnc.greeting)


def test_pulses_per_second_are_rounded_from_a_word(bench: Make) -> None:
    cnc = bench("@mcode(100, 'Q')\ndef a(m, Q): m.pwm('vacuum', 0.5, hz=Q)")
    pulses: list[Any] = []
    cnc.say(*lines("M100Q499.6"), lambda: pulses.append(dict(cnc.rig.port.own_pulses)))
    assert pulses == [{0: (500, 32768)}] and isinstance(pulses[0][0][0], int)


# Jogs

_JOG = """
@on.input("sensor")
def sensor(m, closed):
    if closed: heard.append(m.jog("x", 1, 500))
"""


@pytest.mark.parametrize("at_ms", [*range(0, 600, 60), 440, 460, 485, 499])
def test_no_line_is_lost_to_a_jog(bench: Make, at_ms: int) -> None:
    """The sensor closes at some time of a program: m.jog() is refused (False), the program ends.

    The first 500 ms are a dwell, in which nothing moves.
    """
    cnc = bench(_JOG)

    def close_sensor() -> None:
        cnc.rig.port.push({"pin_22": True})

    program = "G4P0.5\nG1X5F500\nG1X3\nM5\n"
    replies = cnc.say((program, f"ms {at_ms}"), close_sensor, ("", "ms 4000"))
    assert [*replies[0], *replies[1]] == ["ok"] * 4 and cnc.mm[0] == 3
    assert cnc.heard == [False]


def test_jog_while_idle_starts_at_once(bench: Make) -> None:
    cnc = bench(_JOG)
    cnc.say(("G0X2\n", "idle"), lambda: cnc.rig.port.push({"pin_22": True}), ("", "ms 2000"))
    assert cnc.heard == [True] and cnc.mm[0] == 3


def test_received_line_cancels_a_pending_jog(bench: Make) -> None:
    cnc = bench('@mcode(100)\ndef a(m): heard.append(m.jog("x", 9, 500))')
    replies = cnc.say(("M100\nG0Y1\n", "idle"), *lines("M100"), ("", "ms 3000"))
    assert replies[0] == ["ok", "ok"] and cnc.heard == [False, True] and cnc.mm[:2] == [9, 1]


# Findings of `custom check`


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        ("@on.after_reset\ndef a(m): m.g('G21')", "refused with 9: G21: in Alarm, after a reset"),
        ("@on.report\ndef a(m): return 5", "on.report: it must return a text or None, not 5"),
        ("@mcode(100)\ndef a(m): sys.exit()", "mine.py, line 3: SystemExit"),
        ("sys.exit()", "mine.py, line 2: SystemExit"),
        ("@mcode\ndef a(m): pass", "mine.py, line 2: TypeError: write @mcode(100)"),
        ("@mcode(100, sync='no')\ndef a(m): pass", "sync must be True, False or None, not 'no'"),
    ],
)
def test_check_reports_it_before_it_is_on_a_board(tmp_path: Path, text: str, finding: str) -> None:
    """Run `ugrbl custom check` on a file; COLUMNS keeps each finding on one line."""
    file = tmp_path / "mine.py"
    file.write_text("import sys; from ugrbl import mcode, on\n" + text)
    done = CliRunner().invoke(app, ["custom", "check", str(file)], env={"COLUMNS": "500"})
    assert done.exit_code == 1 and "BAD" in done.output and finding in done.output


def test_check_accepts_a_handler_that_reads_the_state_after_a_reset(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    body = "if m.state == 'Idle': m.set_length(3)"
    file.write_text(f"from ugrbl import on\n@on.after_reset\ndef a(m):\n    {body}\n")
    assert CliRunner().invoke(app, ["custom", "check", str(file)]).exit_code == 0


# Under MicroPython

_ON_MICROPYTHON = """
import json
from extras.custom.persistent import PersistentValues
class Saves:
    def load(self, name): return ['["v", nan]', '5', '[["x"], 3]', '["u"', '["a", 8]']
    def save(self, name, lines): print(sorted(lines))
keep = PersistentValues(Saves())
keep["true"] = True
for name, value in (("n", float("nan")), ("i", -float("inf")), ((1, 2), 3)):
    try:
        keep[name] = value
    except (TypeError, ValueError) as fault:
        print(fault)
keep.write()
"""


@needs_micropython
def test_stored_values_can_be_read_back_by_micropython() -> None:
    """NaN, infinity and names that are no text are refused; damaged lines are dropped."""
    assert run_micropython(_ON_MICROPYTHON, paths=[placed_firmware()]).splitlines() == [
        "m.keep: n is not finite",
        "m.keep: i is not finite",
        "m.keep: the name (1, 2) must be a text",
        """['["a", 8]', '["true", 1]']""",
    ]
