"""What the code of senders requires of a Grbl, sender by sender, on the rig in virtual time.

These senders cannot run here. Their handling of each line is known from their sources, and from
what they sent to and read from a real Grbl 1.1h; the patterns below are theirs. Senders that can
run here are tested for real: `make test-senders`.

converse(steps, S22=1) runs the generator steps(talk) as the sender of a machine with $22=1.
`yield from talk.send(text, wait)` sends and waits: for an answer to each line ("ok", the default),
for the end of motion too ("idle"), for a status report ("report") or the welcome ("banner"), or
some ms of the machine's time ("ms 200"); talk.lines then has the lines received since the last
send, talk.report() the last status report. "\\x18" is the reset, Ctrl-X.
"""

import re
from collections.abc import Callable, Generator
from typing import Any

import pytest
from ugrbl import paths
from ugrbl.boardfile.files import load_board
from ugrbl.run import machine

paths.use_firmware(fast=False)

from ugrbl.sim.engine import Switch  # noqa: E402
from ugrbl.sim.replay import factory_store  # noqa: E402
from ugrbl.sim.rig import MemoryStore, Rig  # noqa: E402
from ugrbl.sim.sender import Sender  # noqa: E402

Steps = Generator[Any, None, None]
_BOARD = load_board(machine.DEFAULT_BOARD)
_BANNER = "Grbl 1.1h ['$' for help]"
_PATIENCE_MS = 60_000


class Talk:
    """A sender at a machine; its methods are steps of a conversation."""

    def __init__(self, store: MemoryStore) -> None:
        self.rig = Rig(_BOARD, store)
        self.sender = Sender(self.rig)
        self.lines: list[str] = []

    def send(self, data: str, wait: str = "ok") -> Steps:
        """Send, wait as conversations do; the lines received are in `lines`."""
        self.sender.allow(_PATIENCE_MS)
        yield from self.sender.wait(wait, data)
        self.lines = [line for line in self.sender.take() if line]

    def wait_ms(self, milliseconds: float) -> Steps:
        """Wait this time, and collect the lines received."""
        yield self.rig.ms(milliseconds)
        self.lines = [line for line in self.sender.take() if line]

    def wait_until_idle(self) -> Steps:
        """Ask for reports until the machine is idle."""
        while True:
            yield from self.send("?", "report")
            if "<Idle" in self.lines[-1]:
                return
            yield self.rig.ms(50)

    def report(self) -> str:
        """Return the last status report."""
        return [line for line in self.lines if line.startswith("<")][-1]


def converse(steps: Callable[[Talk], Steps], **settings: float) -> None:
    """Switch a machine on, wait for its banner, and run the steps. settings: `S22=1` is $22=1."""
    store = factory_store(_BOARD)
    stored = dict(line.split("=") for line in store.files["settings"])
    stored |= {f"${name[1:]}": f"{value:g}" for name, value in settings.items()}
    store.files["settings"] = [f"{number}={value}" for number, value in stored.items()]
    talk = Talk(store)

    def script() -> Steps:
        yield from talk.send("", "banner")
        yield from steps(talk)

    talk.rig.run(script())


def answers(lines: list[str]) -> list[str]:
    return [line for line in lines if line == "ok" or line.startswith("error:")]


# Settings: maximum rates in mm/min, accelerations in mm/s².
_FAST = {"S110": 3000, "S111": 3000, "S112": 3000, "S120": 500, "S121": 500, "S122": 500}
_LONG = "G91 G1 X40 F600\n"  # four seconds of motion


# UGS: GrblUtils, GrblCommunicator, GrblControllerInitializer


def test_ugs_recognises_the_banner() -> None:
    """UGS reads version and letter with this pattern."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("\x18", "banner")
        assert talk.lines[0].startswith("Grbl ")
        assert re.search(r"Grbl (\d\.\d)([a-z])", talk.lines[0]).groups() == ("1.1", "h")

    converse(steps)


def test_ugs_gets_a_status_report_before_anything_else() -> None:
    """UGS asks for it before it knows the version, and expects the work offset in the first
    one."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("?", "report")
        assert re.match(r"<Idle\|MPos:0.000,0.000,0.000\|FS:0,0\|WCO:", talk.report())

    converse(steps)


@pytest.mark.parametrize("state", ["Alarm", "Hold:0"])
def test_ugs_gets_an_answer_to_an_empty_line_in_any_initial_state(state: str) -> None:
    def steps(talk: Talk) -> Steps:
        """Bring the machine into this state; as UGS then does, send an empty line or a reset."""
        # With homing on (S22=1) the machine starts in an alarm.
        if state == "Hold:0":
            yield from talk.send("!", "ms 100")
        yield from talk.send("?", "report")
        assert talk.report().startswith(f"<{state}|")
        if state == "Alarm":  # a held machine answers no lines: UGS sends a reset there
            yield from talk.send("\n")
            assert talk.lines == ["ok"]
        else:
            yield from talk.send("\x18", "banner")
            assert talk.lines[0] == _BANNER

    converse(steps, **({"S22": 1} if state == "Alarm" else {}))


def test_ugs_can_read_the_version() -> None:
    """`pattern` is UGS' own, for the line [VER:1.1h…] of $I."""
    pattern = re.compile(r"^\[[a-zA-Z0-9:\s]*[vV]?(\d+)\.(\d+)([a-zA-Z])?.*?]$")

    def steps(talk: Talk) -> Steps:
        yield from talk.send("$I\n")
        found = pattern.match(talk.lines[0])
        assert found and found.groups() == ("1", "1", "h")
        assert re.match(r"^\[OPT:[A-Z+]*,\d+,\d+]$", talk.lines[1])

    converse(steps)


def test_ugs_can_start_up_from_version_settings_and_modes() -> None:
    """UGS sends these three commands and takes every line before the ok for a part of the
    answer."""

    def steps(talk: Talk) -> Steps:
        """Send what UGS asks for at first; each answer has only lines of its kind, and ok."""
        for command, kind in (
            ("$I", r"\[(VER|OPT):"),
            ("$$", r"\$\d+=[\d.]+$"),
            ("$G", r"\[GC:G"),
        ):
            yield from talk.send(command + "\n")
            assert talk.lines[-1] == "ok"
            assert all(re.match(kind, line) for line in talk.lines[:-1])

    converse(steps)


def test_ugs_can_keep_128_bytes_unanswered() -> None:
    """UGS sends so many bytes before it waits for answers: Grbl's receive buffer."""
    line = "G1X1.25Y2.5F600\n"
    count = 128 // len(line)

    def steps(talk: Talk) -> Steps:
        yield from talk.send(line * count)
        assert talk.lines == ["ok"] * count

    converse(steps, **_FAST)


# gSender: src/server/lib/Connection.js


def test_gsender_recognises_grbl_and_not_grblhal() -> None:
    """gSender looks for these names anywhere in the answer to $I."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("$I\n")
        text = "\n".join(talk.lines)
        assert re.search(r"grbl|fluidnc", text, re.IGNORECASE)
        assert not re.search(r"grblhal", text, re.IGNORECASE)

    converse(steps)


def test_gsender_recognises_a_machine_that_has_greeted_before() -> None:
    """It hears no banner, and asks for $I five times, 800 ms apart; each gets one ok."""

    def steps(talk: Talk) -> Steps:
        """Ask five times; each time there is one answer."""
        yield from talk.wait_ms(5000)  # the banner was long ago
        for _ in range(5):
            yield from talk.send("$I\n")
            assert len(answers(talk.lines)) == 1
            yield from talk.wait_ms(800)

    converse(steps)


def test_gsender_gets_a_banner_after_resetting_a_locked_machine() -> None:
    """With homing on (S22=1) the machine is locked: the reset brings the banner, and $X
    unlocks."""

    def steps(talk: Talk) -> Steps:
        """Reset: banner and message come; $X is then accepted."""
        yield from talk.send("\x18", "banner")
        assert talk.lines[0] == _BANNER
        assert "[MSG:'$H'|'$X' to unlock]" in talk.lines
        yield from talk.send("$X\n")
        assert talk.lines[-1] == "ok"

    converse(steps, S22=1)


def test_gsender_can_rely_on_the_free_bytes_of_reports() -> None:
    """With $10=3, reports have |Bf:blocks,bytes: what is free. Every line sent into it gets an
    ok."""

    def steps(talk: Talk) -> Steps:
        """Read |Bf:blocks,bytes of a report, and send as many bytes as gSender would."""
        yield from talk.send("?", "report")
        free = re.search(r"\|Bf:(\d+),(\d+)", talk.report())
        assert free and int(free[1]) == 15  # blocks of the planner, then bytes of the buffer
        # It sends up to eight bytes less than that at once.
        bytes_at_once = int(free[2]) - 8
        line = "G4P0\n"
        yield from talk.send(line * (bytes_at_once // len(line)))
        assert talk.lines == ["ok"] * (bytes_at_once // len(line))

    converse(steps, S10=3)


# LightBurn


def test_lightburn_gets_the_banner_and_the_settings_of_its_bed() -> None:
    def steps(talk: Talk) -> Steps:
        """Do what LightBurn does to find a laser: reset, $I, $$."""
        yield from talk.send("\x18", "banner")
        assert talk.lines[0] == _BANNER
        yield from talk.send("$I\n")
        assert talk.lines[0].startswith("[VER:1.1h.")
        yield from talk.send("$$\n")
        settings = dict(line.split("=") for line in talk.lines[:-1])
        # Highest power, laser mode, travel of X and Y.
        for number in ("$30", "$32", "$130", "$131"):
            assert float(settings[number]) >= 0

    converse(steps)


def test_lightburn_can_burn_with_m4_at_speed_dependent_power() -> None:
    """With $32=1, laser mode, the power is on only while moving."""

    def steps(talk: Talk) -> Steps:
        """Burn a line with M4: some power in motion, none afterwards."""
        yield from talk.send("M4 S500\nG91 G1 X20 F1200\n", "ms 400")
        assert answers(talk.lines) == ["ok", "ok"]
        assert 0 < talk.rig.port.spindle_pwm < 200  # of 255: S500 is half of $30
        yield from talk.wait_until_idle()
        assert talk.rig.port.spindle_pwm == 0  # off at rest

    converse(steps, S32=1, **_FAST)


def test_lightburn_can_jog_and_cancel_the_jog() -> None:
    def steps(talk: Talk) -> Steps:
        """Jog 100 mm and cancel after 0.3 s: the machine stops on the way, and stays there."""
        yield from talk.send("$J=G91X100F3000\n", "ms 300")
        assert talk.lines == ["ok"]
        yield from talk.send("\x85", "ms 500")  # the byte that cancels a jog
        yield from talk.wait_until_idle()
        stopped = talk.report()
        yield from talk.wait_ms(1000)
        yield from talk.send("?", "report")
        # State and position, the first two fields, do not change any more.
        assert talk.report().split("|")[:2] == stopped.split("|")[:2]
        assert "MPos:0.000" not in stopped and "MPos:100" not in stopped  # in between

    converse(steps, **_FAST)


def test_lightburn_streams_a_raster_by_character_counting() -> None:
    """LightBurn keeps as many lines unanswered as fit into the buffer; each gets its ok."""
    # 150 pixels of 0.1 mm.
    lines = ["G91", "M4 S0"] + [f"G1X0.1S{100 + n % 800}F3000\n".strip() for n in range(150)]

    def steps(talk: Talk) -> Steps:
        # "stream": a new line is sent when answers have made space for it.
        yield from talk.send("".join(line + "\n" for line in [*lines, "M5"]), "stream")
        assert talk.lines == ["ok"] * (len(lines) + 1)  # with M5

    converse(steps, S32=1, **_FAST)


# LaserGRBL: LaserGRBL/Core/GrblCore.cs


def test_lasergrbl_reads_the_version_at_fixed_columns_after_its_reset() -> None:
    """LaserGRBL takes the digits and the letter of "Grbl 1.1h" from characters 5, 7 and 8."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("\x18", "banner")
        banner = talk.lines[0]
        assert banner.startswith("Grbl ")
        assert (banner[5], banner[7], banner[8]) == ("1", "1", "h")

    converse(steps)


def test_lasergrbl_may_fill_the_reported_receive_buffer_to_the_last_byte() -> None:
    """LaserGRBL reads the buffer's size from [OPT:…,blocks,bytes] and keeps so much unanswered."""

    def steps(talk: Talk) -> Steps:
        """Fill the buffer of a held machine, resume, and count the answers."""
        yield from talk.send("$I\n")
        size = int(re.search(r"\[OPT:.*,(\d+)]", "\n".join(talk.lines))[1])
        # The machine is held, so that no line is executed and answered in the meantime.
        yield from talk.send("G91 G1 X5 F600\n")
        yield from talk.send("!", "ms 500")
        line = "G1X1F600\n"
        count = size // len(line)
        yield from talk.send(line * count, "ms 100")
        yield from talk.send("~", "ms 20000")  # resume, and wait for all of them
        assert answers(talk.lines) == ["ok"] * count

    converse(steps, **_FAST)


@pytest.mark.parametrize("source", ["firmware/base/errors.py", "firmware/talk/report.py"])
def test_lasergrbl_and_candle_find_ok_only_in_answers(source: str) -> None:
    """For both, a line with "ok" in it answers a command; LaserGRBL ignores case.

    The messages and the other lines of these modules are found as texts in their sources.
    """
    text = (paths.FIRMWARE.parent / source).read_text(encoding="utf-8")
    messages = re.findall(r'^MSG_\w+ = "([^"]*)"', text, re.MULTILINE)
    messages += re.findall(r'b"(\[[^"]*|\\r\\nGrbl[^"]*)"', text)
    assert messages
    for message in messages:
        assert "ok" not in message.lower() and "error" not in message.lower(), message


def test_lasergrbl_and_candle_find_no_ok_in_unsolicited_lines() -> None:
    def steps(talk: Talk) -> Steps:
        """Collect all lines of many situations; "ok" is in none except the answers."""
        received: list[str] = []
        # Lines and bytes that bring messages: check mode, a pause, sleep, a reset.
        for data, wait in (
            ("$$\n$#\n$G\n$I\n$N\n$\n", "ok"),
            ("$C\nG0X1\nM30\n", "ok"),
            ("$C\n", "ms 100"),
            ("M0\n", "ms 100"),
            ("~", "ms 100"),
            ("?", "report"),
            ("$SLP\n", "ms 100"),
            ("\x18", "banner"),
            ("$X\n", "ok"),
        ):
            yield from talk.send(data, wait)
            received += talk.lines
        false_answers = [line for line in received if "ok" in line.lower() and line != "ok"]
        assert false_answers == []
        # "error" is only at the beginning of an answer.
        assert not any("error" in line for line in received if not line.startswith("error:"))

    converse(steps)


def test_lasergrbl_accepts_the_buffer_state_of_reports() -> None:
    """With $10=3, reports have |Bf:blocks,bytes; LaserGRBL concludes the size when all is free."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("?", "report")
        free = int(re.search(r"\|Bf:\d+,(\d+)", talk.report())[1])
        assert free in (128, 255, 256, 10240, 254)  # the sizes that LaserGRBL knows

    converse(steps, S10=3)


def test_lasergrbl_may_resend_a_refused_line() -> None:
    def steps(talk: Talk) -> Steps:
        """Send a refused line three times, then a corrected one."""
        # LaserGRBL repeats a refused line up to three times, and goes on.
        for _ in range(3):
            yield from talk.send("G1 X1\n")  # no feed rate yet
            assert talk.lines == ["error:22"]
        yield from talk.send("G1 X1 F500\n")
        assert talk.lines == ["ok"]

    converse(steps)


# Candle: frmmain.cpp, serialportconnection.cpp


def test_candle_may_end_lines_with_only_a_carriage_return() -> None:
    """Three lines with "\\r" get three answers."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("$G\rG91\rG0X1\r")
        assert answers(talk.lines) == ["ok"] * 3

    converse(steps)


def test_candle_always_gets_the_banner_after_a_reset() -> None:
    """It ignores everything until then, so the banner must come in every state."""
    # Candle's own pattern.
    reset = re.compile(r"^GRBL|GCARVIN\s\d\.\d.")

    def steps(talk: Talk) -> Steps:
        """Reset in each of these states; the banner comes."""
        # Idle, motion, dwell, pause, check mode, sleep, hold, and an unfinished line.
        for before in ("", _LONG, "G4P5\n", "M0\n", "$C\n", "$SLP\n", _LONG + "!", "G9"):
            yield from talk.send(before, "ms 200")
            yield from talk.send("\x18", "banner")
            assert any(reset.match(line.upper()) for line in talk.lines), before
            yield from talk.send("$X\n")

    converse(steps, **_FAST)


def test_candle_reads_settings_joined_with_semicolons() -> None:
    def steps(talk: Talk) -> Steps:
        """Read the settings as Candle does; none is lost."""
        yield from talk.send("$$\r")
        assert not any(";" in line for line in talk.lines)
        response = "; ".join(talk.lines)  # what Candle does, before it searches with the pattern
        settings = dict(re.findall(r"\$(\d+)\=([^;]+)\; ", response))
        assert len(settings) == 34  # Grbl's
        assert settings["110"] == "500.000"

    converse(steps)


def test_candle_may_keep_127_bytes_unanswered() -> None:
    """Candle sends so many bytes before it waits for answers."""
    line = "G1X1.25Y2.50F600\r"
    count = 127 // len(line)

    def steps(talk: Talk) -> Steps:
        yield from talk.send(line * count)
        assert talk.lines == ["ok"] * count

    converse(steps, **_FAST)


# ioSender


def test_iosender_finds_no_trace_of_grblhal_in_the_build_info() -> None:
    """ioSender takes a machine with these words in the answer to $I for grblHAL."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("$I\n")
        assert not any("FIRMWARE" in line or "NEWOPT" in line for line in talk.lines)

    converse(steps)


def test_iosender_may_use_nine_tenths_of_the_reported_buffer() -> None:
    """The size is the last number of [OPT:V,15,128], the second line of $I."""

    def steps(talk: Talk) -> Steps:
        """Send 90 % of the buffer's size at once; each line is answered."""
        yield from talk.send("$I\n")
        size = int(talk.lines[1].rstrip("]").split(",")[2])
        line = "G4P0.001\n"
        count = int(size * 0.9) // len(line)
        yield from talk.send(line * count)
        assert talk.lines == ["ok"] * count

    converse(steps)


# Requirements of all senders: PLATFORM.md D1 and D3, and observations on the wire


def test_every_sender_gets_one_ok_for_each_line_end_like_from_grbl() -> None:
    """Also "\\r\\n" is two line ends, with an answer each."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("\r\n\r\n")  # stream.py begins with this, and reads four
        assert talk.lines == ["ok"] * 4
        yield from talk.send("\n")
        assert talk.lines == ["ok"]

    converse(steps)


@pytest.mark.parametrize("before", ["", _LONG, "G4P1\n", "$$\n$$\n", _LONG + "!"], ids=repr)
def test_every_sender_gets_its_status_within_50_ms(before: str) -> None:
    """before: nothing, a motion, a dwell, long answers, or a hold."""

    def steps(talk: Talk) -> Steps:
        """Bring the machine into a state, and measure the time until a report has come."""
        yield from talk.send("$X\n")
        yield from talk.send(before, "ms 30")
        asked = talk.rig.link.send(b"?")  # the tick at which it arrives
        talk.sender.allow(1000)
        yield from talk.sender.until(lambda: any(x.startswith("<") for x in talk.sender.lines))
        assert talk.rig.now - asked < 50 * talk.rig.ticks_per_ms

    converse(steps, **_FAST)


def test_every_sender_gets_its_status_at_the_end_of_homing_at_the_latest() -> None:
    """Grbl itself is silent while homing, so senders allow for that."""

    def steps(talk: Talk) -> Steps:
        """Ask while homing; a report comes, and homing ends at the right place."""
        for letter, axis in zip("xyz", range(3)):
            # A switch at 10 mm: 2500 steps; after the pull-off of 1 mm the position is -1.
            switch = Switch(f"limit_{letter}", axis, above=True, steps=2500)
            talk.rig.engine.switches.append(switch)
        yield from talk.send("$H\n", "ms 100")
        yield from talk.send("?", "report")
        yield from talk.wait_until_idle()
        assert "MPos:-1.000,-1.000,-1.000" in talk.report()

    converse(steps, S22=1, S25=1000, S24=100, **_FAST)


def test_every_sender_finds_its_work_offset_in_the_first_ten_reports() -> None:
    def steps(talk: Talk) -> Steps:
        """Change the work offset: the next report has it, and then every tenth one."""
        yield from talk.send("G10 L20 P1 X5 Y6 Z7\n")  # G54: the tool is at 5, 6, 7
        yield from talk.send("?", "report")
        assert "|WCO:-5.000,-6.000,-7.000" in talk.report()
        offsets = overrides = 0
        for _ in range(20):
            yield from talk.send("?", "report")
            offsets += "|WCO:" in talk.report()
            overrides += "|Ov:100,100,100" in talk.report()
        # While idle, each of both is in every tenth report.
        assert (offsets, overrides) == (2, 2)

    converse(steps)


def test_cncjs_finds_at_most_six_numbers_in_a_field() -> None:
    """CNCjs' pattern for a field of a report, as in |FS:0,0, has six numbers at most."""

    def steps(talk: Talk) -> Steps:
        for _ in range(12):  # some fields are only in every tenth report
            yield from talk.send("?", "report")
            for field in talk.report()[1:-1].split("|")[1:]:
                assert 1 <= len(field.partition(":")[2].split(",")) <= 6

    converse(steps, S10=3)


def test_every_sender_may_write_settings_while_idle_and_never_in_motion() -> None:
    def steps(talk: Talk) -> Steps:
        """Write $110 while idle, and again during a move of 4 s."""
        yield from talk.send("$110=2000\n")
        assert talk.lines == ["ok"]
        yield from talk.send(_LONG, "ms 200")
        yield from talk.send("$110=1000\n", "ms 50")
        assert talk.lines == ["error:8"]  # not idle

    converse(steps, **_FAST)


def test_a_sender_that_connects_in_motion_gets_all_its_answers() -> None:
    """UGS, gSender and OpenBuilds ask for these; after a refusal they assume another
    controller."""

    def steps(talk: Talk) -> Steps:
        """Ask for version, settings, offsets and startup lines, each during a move."""
        # A move of half a second for each command; it is answered within 200 ms.
        for line, begins in (("$I", "[VER:"), ("$$", "$0="), ("$#", "[G54:"), ("$N", "$N0=")):
            yield from talk.send("G91G1X5F600\n")
            yield from talk.send(line + "\n", "ms 200")
            assert talk.lines[0].startswith(begins) and talk.lines[-1] == "ok"
            yield from talk.send("?", "report")
            assert "<Run" in talk.report()
            yield from talk.send("", "idle")

    converse(steps, **_FAST)


def test_bcnc_and_cncjs_may_send_overrides_as_utf8() -> None:
    def steps(talk: Talk) -> Steps:
        """Send a line with UTF-8 in it: it is executed, and so is the override."""
        # G91 with two bytes in it: 0x91 (feed +10 %) and 0x85; 0xC2 precedes them in UTF-8.
        yield from talk.send("G9\xc2\x911\xc2\x85\n")
        assert talk.lines == ["ok"]
        yield from talk.send("$G\n")
        assert " G91 " in talk.lines[0]
        reports = ""
        for _ in range(3):  # |Ov: is in one of the first reports
            yield from talk.send("?", "report")
            reports += talk.report()
        assert "|Ov:110,100,100" in reports

    converse(steps)


def test_every_realtime_byte_leaves_the_surrounding_line_intact() -> None:
    """Each byte from 0x80 on is sent within G90; the line gets its ok."""

    def steps(talk: Talk) -> Steps:
        for byte in range(0x80, 0x100):
            if byte != 0x84:  # the door: nothing is answered after it
                yield from talk.send(f"G9{chr(byte)}0\n")
                assert talk.lines == ["ok"], hex(byte)

    converse(steps)


def test_bcnc_sees_the_start_button_only_while_pressed() -> None:
    """While idle, bCNC begins to stream if there is an S in Pn:."""

    def steps(talk: Talk) -> Steps:
        """Ask without the button, then press it and ask again."""
        for _ in range(12):  # also with the fields of every tenth report
            yield from talk.send("?", "report")
            assert "|Pn:" not in talk.report()
        talk.rig.port.push({"start": True})
        yield from talk.send("?", "report")
        assert re.search(r"\|Pn:[XYZPDHR]*S", talk.report())

    converse(steps)


def test_bcnc_may_jog_with_a_feed_above_the_machines() -> None:
    """bCNC jogs with F100000: the machine moves at its own highest rate."""

    def steps(talk: Talk) -> Steps:
        yield from talk.send("$J=G91 X5Y5 F100000\n")
        assert talk.lines == ["ok"]
        yield from talk.wait_until_idle()
        assert "MPos:5.000,5.000,0.000" in talk.report()

    converse(steps, **_FAST)


def test_bcnc_may_begin_with_empty_lines_and_end_with_a_purge() -> None:
    def steps(talk: Talk) -> Steps:
        """Begin and end a job as bCNC does."""
        yield from talk.send("\n\n$#\n$G\n")
        assert len(answers(talk.lines)) == 4
        yield from talk.send("G91\nG0X3\n", "ok")
        yield from talk.wait_until_idle()
        # The purge: hold, reset, unlock, and the modes from before.
        yield from talk.send("!", "ms 200")
        yield from talk.send("\x18", "banner")
        yield from talk.send("$X\n")
        yield from talk.send("G0 G54 G17 G21 G90 G94\nG43.1Z0.0\n")
        assert answers(talk.lines) == ["ok", "ok"]
        yield from talk.send("?", "report")
        assert talk.report().startswith("<Idle|MPos:3.000,")  # no position is lost

    converse(steps, **_FAST)


def test_grbl_streamer_may_send_149_bytes_while_the_machine_reads() -> None:
    """More than Grbl's 128: the machine has read the first lines before the last ones arrive."""
    line = "G1X0.5F600\n"

    def steps(talk: Talk) -> Steps:
        yield from talk.send(line * (149 // len(line)))
        assert set(answers(talk.lines)) == {"ok"}

    converse(steps, **_FAST)


def test_simple_stream_gets_no_unsolicited_line() -> None:
    """It takes any line for the answer, so there may be none except the ok."""

    def steps(talk: Talk) -> Steps:
        for line in ("G21", "G91", "G0 X1", "M3 S100", "G1 Y1 F500", "M5", "G4 P0.1", "G90"):
            yield from talk.send(line + "\n", "idle")
            assert talk.lines == ["ok"], line

    converse(steps)
