"""Test the dialect of grblHAL: the requests of senders when they connect, in their order.

gSender and ioSender cannot run here. Their requests, and how they read each answer, are known from
their sources: gSender's GrblHalController.js and its parsers, ioSender's Grbl.cs.

converse() runs a session at a new machine: talk.ask(text, how) sends a text, waits ("ok" if
nothing else is said) and returns the lines received; talk.after(ms, text) sends a text and waits
so long.
"""

import re
import sys
from collections.abc import Generator, Iterator
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from extras.dialects import dialect_hal
from net_bench import NetBench, connected
from ugrbl.boardfile import hal_texts
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.device import checkup
from ugrbl.grbl.messages import alarms, errors
from ugrbl.grbl.settings_file import Firmware
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

Script = Generator[Any, None, None]

_WELCOME = "GrblHAL 1.1f ['$' or '$HELP' for help]"
_FAST = "".join(f"$11{axis}=6000\n$12{axis}=500\n" for axis in range(3))  # rate, acceleration
_PATIENCE_MS = 600_000  # limit of all waits


def board(**options: Any) -> ModuleType:
    module = ModuleType("hal")
    vars(module).update(vars(load_board("sim_hal")), **options)
    return module


class Talk:
    """A sender at a machine; its methods are parts of a session."""

    def __init__(self, machine: ModuleType) -> None:
        self.rig = Rig(machine, factory_store(machine))
        self.sender = Sender(self.rig)

    def ask(self, text: str, how: str = "ok") -> "Generator[Any, None, list[str]]":
        """Send text, wait as Sender.wait() does, and return the lines received."""
        yield from self.sender.wait(how, text)
        return [line for line in self.sender.take() if line]

    def after(self, milliseconds: float, text: str = "") -> "Generator[Any, None, list[str]]":
        return self.ask(text, f"ms {milliseconds}")


@pytest.fixture
def converse(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function run(session, **options of the board).

    It switches a machine on, waits for its welcome, and runs session(talk) with a Talk.
    """

    def run(session: Any, **options: Any) -> Talk:
        """Run session(talk) at a new machine; options: of the board file.

        hal.txt, the texts of the answers, is made for this board and read from memory.
        """
        machine = board(**options)
        texts = hal_texts.made(machine)[hal_texts.name()]
        monkeypatch.setattr(dialect_hal, "texts", lambda: BytesIO(texts))
        talk = Talk(machine)

        def script() -> Script:
            talk.sender.allow(_PATIENCE_MS)
            assert (yield from talk.ask("", "banner")) == [_WELCOME]
            yield from session(talk)

        talk.rig.run(script())
        return talk

    return run


def only(lines: list[str], start: str) -> str:
    """Return the one line that begins so."""
    matches = [line for line in lines if line.startswith(start)]
    assert len(matches) == 1, lines
    return matches[0]


# Connection


def test_gsender_connects(converse: Any) -> None:
    """The requests that gSender sends when it connects, each answer matched by its patterns."""

    def firmware(line: str) -> str:
        """Return the firmware that a line names, as gSender reads it; "": none."""
        for word in ("grblhal", "grbl", "fluidnc"):
            if word in line.lower():
                return word
        return ""

    def session(talk: Talk) -> Script:
        """Connect as gSender does."""
        assert firmware(_WELCOME) == "grblhal"
        # Without a welcome the first answer decides.
        lines = yield from talk.ask("$I\n")
        assert next(filter(None, map(firmware, lines))) == "grblhal"
        (report,) = yield from talk.ask("\x87", "report")
        # \x87 requests a full report: all fields, at any time.
        state, field_texts = re.fullmatch(r"<(\w+)(?::\d*)?\|(.*\|FW:grblHAL)>", report).groups()
        fields = dict(field.split(":") for field in field_texts.split("|"))
        assert state == "Idle" and fields["T"] == "0" and "SD" not in fields
        assert fields["WCO"] == fields["MPos"] == "0.000,0.000,0.000"
        assert fields["Ov"] == "100,100,100"
        # It reads the status from a plain report, which also starts its counter for overrides.
        plain = (yield from talk.ask("?", "report")) + (yield from talk.ask("?", "report"))
        assert sum("|Ov:100,100,100" in report for report in plain) == 1
        lines = yield from talk.ask("$I\n")
        build = int(re.match(r"\[VER:1\.1f\.(\d+):", lines[0])[1])
        assert build > 20250627  # settings by their current numbers, and $spindlesh
        assert re.fullmatch(r"\[AXS:(.+)\]", only(lines, "[AXS"))[1] == "3:XYZ"
        settings = yield from talk.ask("$$\n")
        numbers = {int(line[1:].split("=")[0]) for line in settings[:-1]}  # of $110=500: 110
        # Descriptions: settings, their details, groups, alarms, errors; then offsets.
        lines = yield from talk.ask("$ES\n$ESH\n$EG\n$EA\n$EE\n$#\n")
        assert lines.count("ok") == 6 and not [line for line in lines if "error:" in line]
        described = {
            int(match[1]): match[2].split("|")
            for match in (re.match(r"\[SETTING:(\d+)\|(.+?)(?=\])", line) for line in lines)
            if match
        }
        assert set(described) == numbers
        assert described[110] == "43|Maximum rate X|mm/min|6|#####0.000|0||0|0".split("|")
        details = [line.split("\t") for line in lines if re.fullmatch(r"(\d*)\t(.*)", line)]
        assert {int(row[0]) for row in details} == numbers
        assert {len(row) for row in details} == {10} and details[0][5].startswith("Length of one")
        groups = [re.fullmatch(r"\[SETTINGGROUP:(\d+)\|(\d+)\|(.*)\]", line) for line in lines]
        assert {row[0] for row in described.values()} <= {match[1] for match in groups if match}
        for kind, known in (("ALARM", alarms()), ("ERROR", errors())):
            rows = [re.fullmatch(rf"\[{kind}CODE:(\d+)\|\|(.+)\]", line) for line in lines]
            assert {int(match[1]) for match in rows if match} == set(known)
        lines = yield from talk.ask("$spindlesh\n")
        assert lines == ["[SPINDLE:0|0|0|*DV|PWM|0,1000]", "ok"]

    converse(session)


def test_iosender_connects(converse: Any) -> None:
    """The requests that ioSender sends when it connects, each answer read as it reads them."""

    def session(talk: Talk) -> Script:
        """Connect as ioSender does."""
        (report,) = yield from talk.ask("\x87", "report")
        assert "FW:grblHAL" in report.rstrip(">").split("|")
        lines = yield from talk.ask("$I+\n")
        assert only(lines, "[FIRMWARE") == "[FIRMWARE:grblHAL]"
        assert only(lines, "[OPT").rstrip("]").split(",")[1:] == ["15", "1024", "3", "0"]
        assert only(lines, "[NEWOPT")[8:-1].split(",") == ["ENUMS"]
        for command, start, parts in (
            ("$EA", "[ALARMCODE:", 3),
            ("$EE", "[ERRORCODE:", 3),
            ("$ES", "[SETTING:", 10),
            ("$EG", "[SETTINGGROUP:", 3),
        ):
            rows = yield from talk.ask(command + "\n")
            assert rows.pop() == "ok" and rows
            for row in rows:
                assert row.startswith(start)
                cells = row[len(start) :].rstrip("]").split("|")
                assert len(cells) == parts and int(cells[0]) >= 0
        assert (yield from talk.ask("$+\n")) == (yield from talk.ask("$$\n"))
        lines = yield from talk.ask("$G\n")
        assert lines[0] == "[GC:G0 G54 G17 G21 G90 G94 G49 M5 M9 T0 F0 S0]"
        assert (yield from talk.ask("$#\n"))[-1] == "ok"
        lines = yield from talk.ask("$SPINDLESH\n")
        assert len(lines[0].rstrip("]").split("|")) == 6 and lines[1:] == ["ok"]
        for question in "\x87?\x80":  # full report, report, and grblHAL's byte for ?
            assert len((yield from talk.ask(question, "report"))) == 1

    converse(session)


def test_options_of_the_board_are_reported(converse: Any, tmp_path: Path) -> None:
    """A board with a rotary axis A and a folder with jobs; homing and laser are switched on."""

    def session(talk: Talk) -> Script:
        """Read what the answers say about homing, jobs, A, tool length, tool, and laser."""
        yield from talk.ask("$22=1\n")
        lines = yield from talk.ask("$I\n")
        assert "[NEWOPT:ENUMS,HOME,SD]" in lines and "[AXS:4:XYZA]" in lines
        yield from talk.ask("G43.1Z-2\nT3\n")
        # A tool length is active: G43.1 in place of G49.
        assert " G43.1 M5" in (yield from talk.ask("$G\n"))[0]
        (report,) = yield from talk.ask("\x87", "report")
        assert report.endswith("|WCO:0.000,0.000,-2.000,0.000|T:3|SD:1|FW:grblHAL>")
        lines = yield from talk.ask("$FM\n$F\n$F+\n")
        assert lines.count("ok") == 3
        lines = yield from talk.ask("$32=1\n$SPINDLESH\n")
        assert lines[1] == "[SPINDLE:0|0|0|*DLV|PWM|0,1000]"  # L: laser
        lines = yield from talk.ask("$ES\n")
        assert only(lines, "[SETTING:103|") == (
            "[SETTING:103|46|Steps per degree A|step/deg|6|#####0.000|0||0|0]"
        )

    (tmp_path / "jobs").mkdir()
    converse(session, STEP=(0, 1, 2, 3), ROTARY="A", JOBS=str(tmp_path / "jobs"))


def test_a_words_move_the_a_axis(converse: Any) -> None:
    def session(talk: Talk) -> Script:
        yield from talk.ask(_FAST + "$113=6000\n$123=500\n")
        yield from talk.ask("G1A45F5000\n", "idle")
        (report,) = yield from talk.ask("?", "report")
        assert "MPos:0.000,0.000,0.000,45.000" in report

    converse(session, STEP=(0, 1, 2, 3))


def test_text_rows_fit_into_lines() -> None:
    """The file hal.txt has a line per description. No text may look like an answer to a sender."""
    rows = hal_texts.made(board(TOOL="punch"))[hal_texts.name()].split(b"\r\n")
    assert rows.pop() == b""
    for row in rows:
        assert len(row) < 400 and row.isascii() and b"\n" not in row
        assert not re.search(rb"\b(ok|error)\b", row), row
    assert not hal_texts.made(load_board("sim"))  # a board of another dialect has no such file
    assert any(row.startswith(b"ES 30 [SETTING:30|6|Punch") for row in rows), "the punch's own"


def test_missing_text_file_is_reported_with_the_remedy(converse: Any, monkeypatch: Any) -> None:
    """hal.txt, which has the descriptions of $ES, cannot be opened."""

    def session(talk: Talk) -> Script:
        monkeypatch.setattr(dialect_hal, "texts", lambda: open("/nowhere/hal.txt", "rb"))
        lines = yield from talk.ask("$ES\n")
        assert lines == ["[MSG:hal.txt is not on the board: ugrbl deploy puts it there]", "ok"]

    converse(session)


def test_unknown_commands_are_refused(converse: Any) -> None:
    """$EX does not exist; $HELP does, and replies as $."""

    def session(talk: Talk) -> Script:
        assert (yield from talk.ask("$EX\n")) == ["error:3"]
        assert (yield from talk.ask("$HELP\n")) == (yield from talk.ask("$\n"))

    converse(session)


def test_reading_commands_are_answered_in_motion(converse: Any) -> None:
    """A move of 2 s runs; senders ask for descriptions at any time."""

    def session(talk: Talk) -> Script:
        """Send the commands during a move of 2 s."""
        yield from talk.ask(_FAST)
        yield from talk.ask("G1X20F600\n", "ok")
        for command in ("$ES", "$EE", "$+", "$SPINDLESH", "$HELP"):
            assert (yield from talk.ask(command + "\n"))[-1] == "ok", command
        assert (yield from talk.ask("?", "report"))[0].startswith("<Run")

    converse(session)


def test_unanswered_bytes_of_gsender_are_not_lost(converse: Any) -> None:
    """It sends 724 bytes whatever [OPT:] says, because grblHAL's buffer has 1024."""
    lines = [f"G1 X{k % 2}.{k % 10}00 Y0.{k % 10}00 F1200\n" for k in range(31)]

    def session(talk: Talk) -> Script:
        """Send up to 724 bytes at once, during a move; every line must be answered."""
        yield from talk.ask("G1 X5 F600\n")
        sent = "".join(lines)[:724].rpartition("\n")[0] + "\n"
        talk.rig.link.send(sent.encode())  # all at once, during the move
        count = sent.count("\n")
        yield from talk.sender.until(lambda: talk.sender.answers >= count)
        assert [line for line in talk.sender.take() if line] == ["ok"] * count

    converse(session)


# Real-time bytes


def test_bytes_of_grblhal_act_like_those_of_grbl(converse: Any) -> None:
    """In grblHAL, 0x82 is !, 0x80 is ?, 0x81 is ~, and 0x87 a full report."""

    def session(talk: Talk) -> Script:
        """Hold (0x82), report (0x80), resume (0x81) and full report (0x87)."""
        yield from talk.ask(_FAST)
        yield from talk.ask("G1X20F1200\n", "ok")
        yield from talk.after(500, "\x82")
        assert (yield from talk.ask("\x80", "report"))[0].startswith("<Hold:0")
        yield from talk.after(60, "\x81")
        assert (yield from talk.ask("\x87", "report"))[0].startswith("<Run")

    converse(session)


def test_other_bytes_of_grblhal_are_ignored(converse: Any) -> None:
    """Each of them is sent within a line, which is executed as if they were not there."""

    def session(talk: Talk) -> Script:
        for x, byte in enumerate("\x83\x86\x88\x89\x8a\x8b\x8c\xa2\xa3\xa4\xb0\xc2\x05\x14\x1b"):
            assert (yield from talk.ask(f"G0{byte}X{x}{byte}\n", "idle")) == ["ok"]
            assert f"MPos:{x}.000" in (yield from talk.ask("?", "report"))[0]

    converse(session)


def test_byte_sent_as_utf_8_acts(converse: Any) -> None:
    """Some senders encode the byte 0x85, jog cancel, as UTF-8: 0xC2 0x85. It ends the jog."""

    def session(talk: Talk) -> Script:
        """Cancel a jog by 0xC2 0x85: the byte 0x85, encoded as UTF-8."""
        yield from talk.ask(_FAST)
        yield from talk.ask("$J=X50F1200\n", "ok")
        yield from talk.after(500, "\xc2\x85")
        (report,) = yield from talk.ask("?", "report")
        assert report.startswith("<Idle") and "MPos:0.000" not in report
        assert "MPos:50.000" not in report

    converse(session)


@pytest.mark.parametrize("lines", ["G1X50F1200\nG1X60\n", "$1=255\nG1X50F1200\n", "$J=X50F1200\n"])
def test_stop_ends_motion_and_keeps_the_position(lines: str, converse: Any) -> None:
    """grblHAL's stop, 0x19, decelerates, then resets: no alarm, spindle off, idle.

    lines: two moves, a move after which the motors stay enabled ($1=255), a jog.
    """

    def session(talk: Talk) -> Script:
        """Stop (0x19) after 0.5 s; the position is the same 0.5 s later."""
        yield from talk.ask(_FAST + "M3S500\n")
        yield from talk.ask(lines, "ok")
        assert (yield from talk.after(500, "\x19")) == [_WELCOME]
        (report,) = yield from talk.ask("?", "report")
        assert report.startswith("<Idle") and "FS:0,0" in report
        x_mm = float(re.search(r"MPos:([\d.]+)", report)[1])
        assert 0 < x_mm < 50
        (later_report,) = yield from talk.after(500, "?")
        assert f"MPos:{x_mm:.3f}" in later_report

    converse(session)


def test_stop_while_idle_ends_a_hold_and_check_mode(converse: Any) -> None:
    """The stop is 0x19; nothing moves here, so no deceleration precedes its reset."""

    def session(talk: Talk) -> Script:
        """Stop (0x19) in a hold, then in check mode."""
        yield from talk.after(60, "!")
        yield from talk.after(60, "\x19")
        assert (yield from talk.ask("?", "report"))[-1].startswith("<Idle")
        yield from talk.ask("$C\n")
        yield from talk.after(60, "\x19")
        assert (yield from talk.ask("?", "report"))[-1].startswith("<Idle")

    converse(session)


def test_stop_ends_homing_at_once(converse: Any) -> None:
    """The stop (0x19) cannot decelerate like a hold, which homing ignores: the motors stop at
    once, and the position is lost as by a reset (alarm 6)."""

    def session(talk: Talk) -> Script:
        """Stop (0x19) 0.1 s after $H: the motors stop at once, then the machine resets."""
        yield from talk.ask(_FAST)
        yield from talk.after(300, "$22=1\n")
        yield from talk.after(100, "$H\n")
        assert not talk.rig.engine.idle()
        assert (yield from talk.after(50, "\x19")) == ["ALARM:6"]
        assert talk.rig.engine.idle()
        assert _WELCOME in (yield from talk.after(1000))
        assert (yield from talk.ask("?", "report"))[0].startswith("<Alarm")

    converse(session)


def test_stop_ends_parking_at_once(converse: Any) -> None:
    """The stop (0x19) comes while the spindle is retracted after the door (0x84) has opened."""

    def session(talk: Talk) -> Script:
        """Open the door (0x84) with parking; stop (0x19) while the spindle is retracted."""
        yield from talk.ask(_FAST)
        yield from talk.after(300, "$22=1\n$132=200\n")
        yield from talk.ask("M3S500G0Z-90\n", "idle")  # deep, so that parking takes long
        yield from talk.ask("G1X50F600\n", "ok")
        yield from talk.after(300)
        yield from talk.after(300, "\x84")
        assert talk.rig.controller.state.system_motion  # the parking move runs
        assert (yield from talk.after(50, "\x19"))[0] == "ALARM:3"
        assert talk.rig.engine.idle()

    converse(session, PARKING=True)


def test_stop_ends_jogs_that_are_still_waiting(converse: Any) -> None:
    """Of 30 jogs of 1 mm, some are in the planner and some unread when the stop (0x19) comes."""

    def session(talk: Talk) -> Script:
        """Send 30 jogs of 1 mm; stop (0x19) after 3 s; nothing moves afterwards."""
        yield from talk.ask(_FAST)
        yield from talk.ask("$J=G91X1F500\n" * 30, "ms 2000")
        yield from talk.after(1000, "\x19")
        (report,) = yield from talk.ask("?", "report")
        assert report.startswith("<Idle")
        x_mm = re.search(r"MPos:([\d.]+)", report)[1]
        assert 0 < float(x_mm) < 29
        assert f"MPos:{x_mm}," in (yield from talk.after(2000, "?"))[0]

    converse(session)


def test_gsender_stops_a_job_by_force(converse: Any) -> None:
    """It sends a stop (0x19) and a hold at once, then a reset: idle, with no further output."""

    def session(talk: Talk) -> Script:
        """Stop and hold (0x19, !), then reset (0x18): idle, and no more output."""
        yield from talk.ask(_FAST)
        yield from talk.ask("G1X50F1200\n", "ok")
        yield from talk.after(700, "\x19!")
        assert (yield from talk.after(200, "\x18"))[-1] == _WELCOME
        assert (yield from talk.ask("?", "report"))[0].startswith("<Idle")
        assert (yield from talk.after(2000)) == []

    converse(session)


def test_reset_during_a_stop_is_one_reset(converse: Any) -> None:
    """With 5 mm/s2 the stop (0x19) decelerates for seconds. A reset (0x18) comes in this time."""

    def session(talk: Talk) -> Script:
        """Reset (0x18) while a stop (0x19) decelerates with 5 mm/s2: one welcome."""
        yield from talk.ask("$110=6000\n$120=5\n")
        yield from talk.ask("G1X50F1200\n", "ok")
        yield from talk.after(3000)  # its speed is now 15 mm/s
        yield from talk.after(100, "\x19")
        assert (yield from talk.after(2000, "\x18")).count(_WELCOME) == 1

    converse(session)


@pytest.mark.parametrize("together", [True, False])
def test_gsender_unlocks(together: bool, converse: Any) -> None:
    """It sends a stop (0x19) right after $X, with homing required ($22=1: alarm at reset).

    together: in one transmission, so that the stop is read before $X is executed.
    """

    def session(talk: Talk) -> Script:
        """Unlock after a reset that needs homing; the stop (0x19) must not lock again."""
        yield from talk.ask("$22=1\n")
        yield from talk.after(100, "\x18")
        if together:
            lines = yield from talk.after(300, "$X\n\x19")
        else:
            lines = yield from talk.ask("$X\n")
            yield from talk.after(300, "\x19")
        assert "ok" in lines
        assert (yield from talk.ask("?", "report"))[-1].startswith("<Idle")

    converse(session)


def test_full_report_names_the_alarm(converse: Any) -> None:
    """The failed probing move is alarm 5. The full report (0x87) has its number, ? has not."""

    def session(talk: Talk) -> Script:
        """A probing move with nothing to touch is alarm 5: read it, unlock, read again."""
        yield from talk.ask("$21=1\n")
        yield from talk.ask("G38.2X1F100\n", "ok")
        (report,) = yield from talk.ask("\x87", "report")
        assert report.startswith("<Alarm:5|")
        assert (yield from talk.ask("?", "report"))[0].startswith("<Alarm|")
        yield from talk.ask("$X\n")
        assert (yield from talk.ask("\x87", "report"))[0].startswith("<Idle|")

    converse(session)


# The network, and our own tools


def test_network_client_gets_the_welcome_of_grblhal(monkeypatch: Any) -> None:
    """Two clients: both get the welcome; a full report goes only to the one that asked."""
    bench = NetBench(monkeypatch, board=board(LINK="wifi"))

    def script(bench: Any) -> Iterator[Any]:
        """Connect two clients; the second one requests a full report."""
        one, two = bench.call(), bench.call()
        yield from connected(bench, one, f"\r\n{_WELCOME}\r\n")
        yield from connected(bench, two, f"\r\n{_WELCOME}\r\n")
        two.send(b"\x87")
        yield from bench.until(lambda: b">" in two.got)
        assert "FW:grblHAL" in two.take() and "<" not in one.take()

    bench.run(script)


@pytest.mark.parametrize("by", ["cable", "client"])
@pytest.mark.parametrize(("byte", "state"), [(b"\x19", "<Idle|"), (b"\x82", "<Hold:0|")])
def test_stops_of_grblhal_act_during_anothers_control(
    monkeypatch: Any, by: str, byte: bytes, state: str
) -> None:
    """byte: stop or hold; by: its source, the cable or a second client, on this computer."""
    bench = NetBench(monkeypatch, board=board(LINK="wifi"))

    def script(bench: Any) -> Iterator[Any]:
        """One client moves, another one stops it."""
        one, two = bench.call(), bench.call()
        yield from connected(bench, one, f"\r\n{_WELCOME}\r\n")
        yield from connected(bench, two, f"\r\n{_WELCOME}\r\n")
        yield from bench.ask(one, "G91G1X50F1500\n")
        yield from bench.wait(500)
        (bench.rig.link.cable if by == "cable" else two).send(byte)
        yield from bench.wait(1500)  # it slows down
        assert 0 < bench.steps()[0] < 20 * 250  # 250 steps/mm
        one.take()
        one.send(b"?")
        yield from bench.until(lambda: b">" in one.got)
        assert one.take().startswith(state)

    bench.run(script)


def test_build_for_this_dialect_contains_the_texts(monkeypatch: Any) -> None:
    """hal.txt is in the build of a Pico with DIALECT="hal"; nothing is compiled here."""
    monkeypatch.setattr(build, "compile_all", lambda *_: build.Build("armv6m"))
    pico = Path(__file__).parents[2] / "boards" / "rpi_pico.py"
    monkeypatch.setattr(build, "load_for_build", lambda file: vary(load_board("rpi_pico")))
    result = build.for_board(pico)
    assert result.files["hal.txt"] and "hal.txt" in result.own


def vary(pico: Any) -> ModuleType:
    module = ModuleType("pico")
    vars(module).update(vars(pico), DIALECT="hal")
    return module


def test_doctor_recognises_our_firmware() -> None:
    ours = Firmware.read(["[VER:1.1f.20261121:GrblHAL pio 400000Hz mine]", "[OPT:V,15,128,3,0]"])
    assert checkup.is_ours(ours) and not checkup.is_relative(ours)
    theirs = Firmware.read(["[VER:1.1f.20261121:]", "[FIRMWARE:grblHAL]"])
    assert not checkup.is_ours(theirs)


def test_default_dialect_has_none_of_it() -> None:
    """Grbl 1.1 does not answer the bytes 0x80, 0x87 and 0x19, and refuses grblHAL's commands."""
    plain = load_board("sim")
    rig = Rig(plain, factory_store(plain))
    sender = Sender(rig)

    def script() -> Script:
        """Send grblHAL's bytes, which get no answer, and commands, which are refused."""
        sender.allow(_PATIENCE_MS)
        yield from sender.wait("banner", "")
        sender.take()
        yield from sender.wait("ms 100", "\x80\x87\x19")
        assert sender.take() == []
        for line in ("$ES", "$+", "$SPINDLESH"):
            yield from sender.wait("ok", line + "\n")
            assert sender.take()[0].startswith("error:")

    rig.run(script())


def test_help_is_no_homing_for_custom_handlers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, converse: Any
) -> None:
    """$HELP begins as $H does, after which on.after_homing runs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "custom_hal.py").write_text(
        "from ugrbl import on\nheard = []\n@on.after_homing\ndef homed(m): heard.append(1)\n"
    )

    def session(talk: Talk) -> Script:
        assert (yield from talk.ask("$HELP\n"))[-1] == "ok"
        yield from talk.after(100)

    converse(session, CUSTOM="custom_hal")
    assert sys.modules["custom_hal"].heard == []
