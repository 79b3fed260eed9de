"""Grbl's output and its timing in surprising cases: see ../shared/GRBL-FACTS.md.

bench.say(text, how) sends text and returns the lines received until it is answered ("ok"), the
machine is idle ("idle", the default), a report or banner has come, or after a time ("ms 100"). A
script yields the tick at which it is resumed; rig.ms(n) is the tick n ms from now.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from test_settings_effects import Bench

_WELCOME = ["", "Grbl 1.1h ['$' for help]"]
_LOCKED = "[MSG:'$H'|'$X' to unlock]"

Script = Iterator[Any]


def fields(report: "list[str]") -> "dict[str, str]":
    """Return the fields of a status report, the last line; the state has the key ""."""
    state, *rest = report[-1][1:-1].split("|")
    return {"": state, **dict(field.split(":", 1) for field in rest)}


def status(bench: Bench) -> Script:
    """Ask for a status report and return its fields."""
    return fields((yield from bench.say("?", "report")))


def both_reports(bench: Bench) -> Script:
    """Wait for two status reports, after which all occasional fields have been shown."""
    yield from status(bench)
    yield from status(bench)


@pytest.mark.parametrize("line", ["$10=1", "$13=1"])
def test_offsets_are_reported_again_after_a_setting_changes_their_units(line: str) -> None:
    """WCO is reported now and then only, but at once after $13 (inches); $10 does not change
    units."""
    bench = Bench({})

    def script() -> Script:
        yield from both_reports(bench)
        assert "WCO" not in (yield from status(bench))
        yield from bench.say(line + "\n")
        assert ("WCO" in (yield from status(bench))) == line.startswith("$13")

    bench.run(script())


def test_output_of_a_startup_line_is_inside_its_echo() -> None:
    """A startup line ($N0) is echoed with its answer, `>M30:ok`, after what it printed."""
    bench = Bench({})

    def script() -> Script:
        yield from bench.say("$N0=M30\n")
        bench.rig.cycle_power()
        lines = yield from bench.say("", "ms 200")
        assert lines == [*_WELCOME, "[MSG:Pgm End]", ">M30:ok"]

    bench.run(script())


def test_a_startup_line_with_motion_is_answered_after_the_motion() -> None:
    """$N0= executes the line to check it, and waits for the motion before it stores the line."""
    bench = Bench({})

    def script() -> Script:
        assert (yield from bench.say("$N0=G91G1X1F500\n", "ok")) == ["ok"]
        assert not bench.rig.moving()
        assert (yield from bench.say("$N0=\n", "ok")) == ["ok"]

    bench.run(script())


def test_permanently_enabled_motors_are_enabled_right_after_a_reset() -> None:
    bench = Bench({1: 255})  # $1=255: never released

    def script() -> Script:
        yield from bench.say("\x18", "banner")
        yield bench.rig.ms(100)
        assert bench.port.enable_pin == 0  # active low

    bench.run(script())


def test_a_spindle_override_is_reported_during_motion() -> None:
    bench = Bench({})

    def script() -> Script:
        yield from bench.say("M3S500\nG91G1X20F300\n", "ok")
        yield bench.rig.ms(300)
        yield from bench.say("\x9a", "ms 30")  # +10 %
        assert (yield from status(bench))["FS"] == "300,550"

    bench.run(script())


@pytest.mark.parametrize("stop", ["!", "\x84"])
@pytest.mark.parametrize(("mode", "fs_at_rest"), [("M3", "0,500"), ("M4", "0,0")])
def test_a_laser_is_on_again_when_motion_resumes(stop: str, mode: str, fs_at_rest: str) -> None:
    """stop: hold or door. M3 keeps the laser on after the motion, M4 does not. fs_at_rest: FS of
    the report then."""
    bench = Bench({32: 1})

    def script() -> Script:
        """Stop a move with the laser on, resume it, and wait for its end; FS is feed and speed."""
        yield from bench.say(mode + "S500\nG91G1X3F300\n", "ok")
        yield bench.rig.ms(200)
        yield from bench.say(stop, "ms 400")
        assert (yield from status(bench))["FS"] == "0,0" and not bench.port.spindle_pwm
        yield from bench.say("~", "ms 150")
        assert bench.port.spindle_pwm
        yield from bench.say("", "idle")
        assert (yield from status(bench))["FS"] == fs_at_rest
        assert bool(bench.port.spindle_pwm) == (mode == "M3")

    bench.run(script())


def test_the_spindle_is_off_and_reported_off_after_homing() -> None:
    bench = Bench({22: 1})

    def script() -> Script:
        """Switch the spindle on, home, and switch it on again. FS: feed, speed."""
        yield from bench.unlock()
        yield from bench.say("M3S500\n")
        assert (yield from status(bench))["FS"] == "0,500"
        yield from bench.say("$H\n")
        assert (yield from status(bench))["FS"] == "0,0" and not bench.port.spindle_pwm
        yield from bench.say("M3S500\n")  # the mode is unchanged: nothing is switched
        assert not bench.port.spindle_pwm

    bench.run(script())


def test_status_requests_in_a_burst_are_answered_before_empty_lines() -> None:
    """Real-time bytes are handled as they are received; requests that wait are answered by one
    report."""
    bench = Bench({})

    def script() -> Script:
        lines = yield from bench.say("?\n?\n?\n", "ms 200")
        kinds = ["report" if line.startswith("<") else line for line in lines]
        assert kinds[0] == "report" and kinds[-3:] == ["ok"] * 3 and len(kinds) <= 6, lines

    bench.run(script())


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("line", ["", "G4P1", "G91G1X20F300"])
def test_each_byte_of_a_burst_of_overrides_counts(count: int, line: str) -> None:
    """While idle, in a dwell and in a move. 0x91: feed +10 %; 0x9d: spindle -1 %."""
    bench = Bench({})

    def script() -> Script:
        """Send feed +10 % and spindle -1 %, `count` times each, in one burst."""
        if line:
            yield from bench.say(line + "\n", "ms 100")
        yield from bench.say("\x91" * count + "\x9d" * count, "ms 200")
        yield from bench.say("", "idle")
        controller = bench.rig.controller
        assert controller.state.feed_override == 100 + 10 * count
        assert controller.state.spindle_override == 100 - count

    bench.run(script())


@pytest.mark.parametrize("sent", ["G1X1F500\n", "$X\n", "?", "$$\n"])
def test_bytes_right_after_an_alarm_are_discarded(sent: str) -> None:
    """Nothing is answered for half a second, and the reset discards it."""
    bench = Bench({})

    def script() -> Script:
        """Reset a move, send more bytes within the silent half second, and wait for the banner."""
        yield from bench.say("G91G1X20F300\n", "ok")
        yield bench.rig.ms(200)
        # a reset during motion is an alarm
        assert (yield from bench.say("\x18", "ms 100")) == ["ALARM:3"]
        assert (yield from bench.say(sent, "ms 350")) == []
        assert (yield from bench.say("", "banner")) == [*_WELCOME, _LOCKED]
        assert (yield from bench.say("", "ms 500")) == []  # no late answer
        assert not bench.rig.moving()

    bench.run(script())


def test_a_probe_without_contact_reports_in_this_order() -> None:
    """[PRB:…:0] is the result, without success; it comes half a second after the alarm."""
    bench = Bench({})

    def script() -> Script:
        lines = yield from bench.say("G38.2X1F500\n", "ms 1200")
        assert lines == ["ALARM:5", "[PRB:0.000,0.000,0.000:0]", "ok"]
        assert (yield from status(bench))[""] == "Alarm"

    bench.run(script())


def test_a_reset_during_a_probe_alarm_acts_after_its_report() -> None:
    """A probe without contact: the reset comes in the half second after ALARM:5 in which nothing
    is sent."""
    bench = Bench({})

    def script() -> Script:
        """Probe without contact, wait for the alarm, and reset at once."""
        lines = yield from bench.say("G38.2X1F500\n", "ms 300")
        while lines != ["ALARM:5"]:
            assert not lines
            lines = yield from bench.say("", "ms 20")
        lines = yield from bench.say("\x18", "ms 900")
        assert lines == ["[PRB:0.000,0.000,0.000:0]", "ok", *_WELCOME, _LOCKED]

    bench.run(script())


@pytest.mark.parametrize("level", [0, 1])
def test_a_probe_ends_at_its_contact_with_either_polarity(level: int) -> None:
    """level: $6 and the level of the open contact; :1] reports success, and G38.3 fails without an
    alarm."""
    bench = Bench({6: level})

    def script() -> Script:
        """Probe to a contact; then probe again without one."""
        bench.port.push({"probe": bool(level)})
        yield from bench.say("G91G38.2X5F300\n", "ms 300")
        bench.port.push({"probe": not level})
        lines = yield from bench.say("", "ms 400")
        assert lines[0].startswith("[PRB:") and lines[0].endswith(":1]") and lines[1:] == ["ok"]
        bench.port.push({"probe": bool(level)})
        assert (yield from bench.say("G91G38.3X0.1F300\n", "ms 1500"))[-1] == "ok"
        assert (yield from status(bench))[""] == "Idle"

    bench.run(script())


def test_a_dwell_reacts_to_a_hold_at_its_next_tick() -> None:
    """Grbl checks for holds every 50 ms of a dwell: 60 ms later it is in hold."""
    bench = Bench({})

    def script() -> Script:
        """Hold 110 ms after the beginning of a dwell, and resume."""
        assert (yield from bench.say("G4P0.5\n", "ms 110")) == []
        yield from bench.say("!", "ms 60")
        assert fields((yield from bench.say("?", "report")))[""] == "Hold:0"
        yield from bench.say("~", "ms 600")
        assert (yield from status(bench))[""] == "Idle"

    bench.run(script())


def test_an_m4_laser_is_off_at_rest() -> None:
    """After moves of all lengths: the laser once stayed on after one move of sixty."""
    bench = Bench({32: 1})

    def script() -> Script:
        yield from bench.say("M4S500\n")
        for hundredths in range(1, 120, 2):
            yield from bench.say(f"G91G1X{hundredths / 100}F600\n")
            assert not bench.port.spindle_pwm and not bench.port.spindle_on, hundredths

    bench.run(script())


def test_offsets_are_stored_at_rest_if_a_reset_interrupts_the_store() -> None:
    """G10 changes offsets; a reset comes as they are about to be stored. They are stored once, and
    not during motion."""
    bench = Bench({})
    was_moving: list[bool] = []

    def script() -> Script:
        """Reset the machine while G10 reports changed offsets; note when they are stored."""
        controller = bench.rig.controller
        save = bench.rig.store.save

        def noted_save(name: str, lines: "list[str]") -> None:
            was_moving.append(bench.rig.moving())
            save(name, lines)

        bench.rig.store.save = noted_save
        apply = controller.interpreter._offsets_changed

        def reset_first() -> None:
            controller.motor_control.reset()
            apply()

        controller.interpreter._offsets_changed = reset_first
        yield from bench.say("G10L2P1X1\n", "banner")
        assert was_moving == [False]

    bench.run(script())
