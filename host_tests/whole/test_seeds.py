"""The promises of the guides in ../shared/seeds, one by one: see docs/seeds.md.

A promise is a conversation. Its board is the one whose Grbl the document describes. promise.talk:
pairs (text, expected lines); None: any lines; * in a line: any characters. Texts: a line, a
real-time byte, "pin limit_x" (an input closes), "now LINE" (does not wait until motion ends), or
"power" (off and on).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from base import state as st
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(15)

_TABLE = Path(__file__).parents[2] / "docs" / "seeds.md"
_OK = ["ok"]
_BANNER = ["", "Grbl 1.1h ['$' for help]"]
_BANNER_09 = ["", "Grbl 0.9i ['$' for help]"]
_LOCKED = "[MSG:'$H'|'$X' to unlock]"
_FAST = ("$110=6000", "$111=6000", "$112=6000", "$120=500", "$121=500", "$122=500")
_ZERO = "0.000,0.000,0.000"
_SYSTEMS = [f"[G{n}:{_ZERO}]" for n in (*range(54, 60), 28, 30, 92)]

# Text sent, and the expected answer; None: any answer.
Exchange = tuple[str, list[str] | None]


class Promise(NamedTuple):
    """name: as in docs/seeds.md, after the document's number."""

    name: str
    talk: tuple[Exchange, ...]
    board: str = "sim"
    settings: tuple[str, ...] = _FAST
    switches: tuple[Switch, ...] = ()


def same_reply(lines: "str", reply: "list[str]" = _OK) -> "tuple[Exchange, ...]":
    """Return lines, separated by spaces, that all get the same reply."""
    return tuple((line, reply) for line in lines.split())


_CZECH = (
    Promise(
        "000 the G and M words listed are there",
        (
            *same_reply(
                "G0 G1F100 G2X1R1 G3X0R1 G4P0.01 G10L2P1X0 G10L20P1X0 G17 G18 G19 G20 G21"
            ),
            *same_reply("G28 G28.1 G30 G30.1 G40 G43.1Z0 G49 G53G0X0 G54 G55 G56 G57 G58 G59 G54"),
            *same_reply("G61 G90 G91 G91.1 G92X0 G92.1 G93 G94 M3 M4 M5 M8 M9 G80"),
            ("G38.3X1F500", None),
            ("pin probe", []),
            ("G38.5X2F500", None),
            ("M2", ["[MSG:Pgm End]", "ok"]),
            ("M30", ["[MSG:Pgm End]", "ok"]),
        ),
    ),
    Promise(
        "000 the first answers",
        (
            (
                "$",
                [
                    "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]",
                    "ok",
                ],
            ),
            ("$#", [*_SYSTEMS, "[TLO:0.000]", f"[PRB:{_ZERO}:0]", "ok"]),
            ("$G", ["[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]", "ok"]),
            ("$N", ["$N0=", "$N1=", "ok"]),
            ("?", [f"<Idle|MPos:{_ZERO}|FS:0,0|WCO:{_ZERO}>"]),
            ("?", [f"<Idle|MPos:{_ZERO}|FS:0,0|Ov:100,100,100>"]),
            ("?", [f"<Idle|MPos:{_ZERO}|FS:0,0>"]),
        ),
    ),
    Promise(
        "000 the settings and their defaults",
        (
            (
                "$$",
                [
                    *"$0=10 $1=25 $2=0 $3=0 $4=0 $5=0 $6=0 $10=1 $11=0.010 $12=0.002".split(),
                    *"$13=0 $20=0 $21=0 $22=0 $23=0 $24=25.000 $25=500.000 $26=250".split(),
                    *"$27=1.000 $30=1000 $31=0 $32=0".split(),
                    *(f"${100 + i}=250.000" for i in range(3)),
                    *(f"${110 + i}=500.000" for i in range(3)),
                    *(f"${120 + i}=10.000" for i in range(3)),
                    *(f"${130 + i}=200.000" for i in range(3)),
                    "ok",
                ],
            ),
        ),
        settings=(),
    ),
    Promise(
        "000 a setting is written with or without spaces", (("$0 = 30", _OK), ("$1 = 50", _OK))
    ),
    Promise(
        "000 masks of 0 to 7 for steps, directions and homing",
        tuple((f"${number}={mask}", _OK) for number in (2, 3, 23) for mask in range(8)),
    ),
    Promise(
        "000 $5 and $6 turn the sense of switches and probe",
        (("$5=1", _OK), ("$6=1", _OK), ("?", [f"<Idle|MPos:{_ZERO}|FS:0,0|Pn:PXYZ|WCO:{_ZERO}>"])),
    ),
    Promise(
        "000 $13 reports in inches",
        (
            ("$13=1", _OK),
            ("G0X25.4", _OK),
            ("?", ["<Idle|MPos:1.0000,0.0000,0.0000|FS:0.0,0|WCO:0.0000,0.0000,0.0000>"]),
        ),
    ),
    Promise(
        "000 soft limits want homing, and alarm without losing the position",
        (
            ("$20=1", ["error:10"]),
            ("$22=1", _OK),
            ("$20=1", _OK),
            ("G0X1", ["ALARM:2", "[MSG:Reset to continue]"]),
            ("\x18", ["ok", *_BANNER, _LOCKED]),
        ),
    ),
    Promise(
        "000 a hard limit stops everything until a reset; $21=0 and $X free the machine",
        (
            ("$21=1", _OK),
            ("M3S500", _OK),
            ("G0X2", ["ok", "ALARM:1", "[MSG:Reset to continue]"]),
            ("\x18", [*_BANNER, "[MSG:Check Limits]", _LOCKED]),
            ("$21=0", _OK),
            ("$X", ["[MSG:Caution: Unlocked]", "ok"]),
            ("G0X1", _OK),
        ),
        switches=(Switch("limit_x", 0, True, 300),),
    ),
    Promise(
        "000 homing enabled locks the axes; $X unlocks them",
        (
            ("$22=1", _OK),
            ("power", [*_BANNER, _LOCKED]),
            ("G0X1", ["error:9"]),
            ("$X", ["[MSG:Caution: Unlocked]", "ok"]),
            ("G0X1", _OK),
        ),
    ),
    Promise(
        "000 homing: Z first, then X and Y, pulled off the switches",
        (
            *same_reply("$22=1 $24=300 $25=3000 $26=5 $27=1"),
            ("$H", _OK),
            ("?", ["<Idle|MPos:-1.000,-1.000,-1.000|FS:0,0|WCO:0.000,0.000,0.000>"]),
        ),
        switches=tuple(Switch(f"limit_{axis}", i, True, 500) for i, axis in enumerate("xyz")),
    ),
    Promise("000 F above the highest rate is cut to it", (("G1X1F99999", _OK),)),
    Promise(
        "000 $I=text is kept and shown",
        (("$I=Stroj 1", _OK), ("$I", ["[VER:1.1h.*STROJ1]", "[OPT:V,15,128]", "ok"])),
    ),
    Promise(
        "000 startup lines run after every start, and can be taken away",
        (
            ("$N0 = G20 G54 G17", _OK),
            ("$N", ["$N0=G20G54G17", "$N1=", "ok"]),
            ("\x18", [*_BANNER, ">G20G54G17:ok"]),
            ("$N0=", _OK),
            ("\x18", _BANNER),
            ("$N0=G99", ["error:20"]),
        ),
    ),
    Promise(
        "000 check mode moves nothing, and ends in a reset",
        (
            ("$C", ["[MSG:Enabled]", "ok"]),
            ("G1X100F100", _OK),
            ("G1", _OK),
            ("G99", ["error:20"]),
            ("?", [f"<Check|MPos:{_ZERO}|FS:0,0|WCO:{_ZERO}>"]),
            ("$C", ["[MSG:Disabled]", "ok", *_BANNER]),
        ),
    ),
    Promise(
        "000 $RST puts back what it says",
        (
            *same_reply("$1=99 G10L2P1X5"),
            ("$RST=$", ["[MSG:Restoring defaults]", "ok", *_BANNER]),
            ("$RST=#", ["[MSG:Restoring defaults]", "ok", *_BANNER]),
            ("$RST=*", ["[MSG:Restoring defaults]", "ok", *_BANNER]),
            ("$#", [*_SYSTEMS, "[TLO:0.000]", f"[PRB:{_ZERO}:0]", "ok"]),
        ),
        settings=(),
    ),
    Promise(
        "000 sleep ends with a reset, in alarm",
        (
            ("$SLP", ["ok", "[MSG:Sleeping]"]),
            ("~", []),
            ("\x18", [*_BANNER, _LOCKED]),
            ("$X", ["[MSG:Caution: Unlocked]", "ok"]),
        ),
    ),
    Promise(
        "000 a dwell may be longer than 6 s",
        (("G4P6.5", _OK),),
    ),
    Promise(
        "000 the status of older versions",
        (
            *same_reply("G10L2P1X4Y6", _OK),
            ("G0X1Y-5", _OK),
            ("?", ["<Idle,MPos:5.000,1.000,0.000,WPos:1.000,-5.000,0.000>"]),
        ),
        board="sim_09i",
    ),
)

_PUNCH = (
    Promise(
        "001 the punch's signals are $30 to $33",
        (
            *same_reply("$30=1 $31=1 $30=0 $31=0 $32=0 $33=0"),
            ("$34=0", ["error: Invalid statement"]),
        ),
        board="sim_punch_09",
    ),
    Promise(
        "001 Lim shows limit pins in the order ZYX",
        (("$10=17", _OK), ("pin limit_z", []), ("?", [f"<Idle,MPos:{_ZERO},Lim:100>"])),
        board="sim_punch_09",
    ),
    Promise(
        "001 $10=3 for both positions",
        (("$10=3", _OK), ("?", [f"<Idle,MPos:{_ZERO},WPos:{_ZERO}>"])),
        board="sim_punch_09",
    ),
    Promise(
        "001 a hold keeps the position, and cycle start goes on",
        (
            ("G0X0.2", _OK),
            ("!", []),
            ("?", ["<Hold,MPos:0.200,0.000,0.000,WPos:0.200,0.000,0.000>"]),
            ("~", []),
        ),
        board="sim_punch_09",
    ),
    Promise(
        "001 check mode answers everything and resets at its end",
        (
            ("$C", ["[Enabled]", "ok"]),
            ("G99", ["error: Unsupported command"]),
            ("$C", ["[Disabled]", "ok", *_BANNER_09]),
        ),
        board="sim_punch_09",
    ),
)

_SPANISH_SETTINGS = """\
$0=10 (step pulse, usec)
$1=25 (step idle delay, msec)
$2=0 (step port invert mask:00000000)
$3=6 (dir port invert mask:00000110)
$4=0 (step enable invert, bool)
$5=0 (limit pins invert, bool)
$6=0 (probe pin invert, bool)
$10=3 (status report mask:00000011)
$11=0.020 (junction deviation, mm)
$12=0.002 (arc tolerance, mm)
$13=0 (report inches, bool)
$20=0 (soft limits, bool)
$21=0 (hard limits, bool)
$22=0 (homing cycle, bool)
$23=1 (homing dir invert mask:00000001)
$24=50.000 (homing feed, mm/min)
$25=635.000 (homing seek, mm/min)
$26=250 (homing debounce, msec)
$27=1.000 (homing pull-off, mm)
$100=314.961 (x, step/mm)
$101=314.961 (y, step/mm)
$102=314.961 (z, step/mm)
$110=635.000 (x max rate, mm/min)
$111=635.000 (y max rate, mm/min)
$112=635.000 (z max rate, mm/min)
$120=50.000 (x accel, mm/sec^2)
$121=50.000 (y accel, mm/sec^2)
$122=50.000 (z accel, mm/sec^2)
$130=225.000 (x max travel, mm)
$131=125.000 (y max travel, mm)
$132=170.000 (z max travel, mm)""".splitlines()

_SPANISH = (
    Promise(
        "002 help, settings and their words",
        (
            (
                "$",
                [
                    "$$ (view Grbl settings)",
                    "$# (view # parameters)",
                    "$G (view parser state)",
                    "$I (view build info)",
                    "$N (view startup blocks)",
                    "$x=value (save Grbl setting)",
                    "$Nx=line (save startup block)",
                    "$C (check gcode mode)",
                    "$X (kill alarm lock)",
                    "$H (run homing cycle)",
                    "~ (cycle start)",
                    "! (feed hold)",
                    "? (current status)",
                    "ctrl-x (reset Grbl)",
                    "ok",
                ],
            ),
            *((line.partition(" ")[0], _OK) for line in _SPANISH_SETTINGS),
            ("$$", [*_SPANISH_SETTINGS, "ok"]),
            ("power", _BANNER_09),
            ("$$", [*_SPANISH_SETTINGS, "ok"]),
        ),
        board="sim_09i",
    ),
    Promise(
        "002 a startup line is shown with its answer",
        (
            ("$N0=G20 G54 G17", _OK),
            ("$N", ["$N0=G20G54G17", "$N1=", "ok"]),
            ("\x18", [*_BANNER_09, "G20G54G17ok"]),
        ),
        board="sim_09i",
    ),
    Promise(
        "002 homing enabled locks the axes",
        (
            ("$22=1", _OK),
            ("power", [*_BANNER_09, "['$H'|'$X' to unlock]"]),
            ("G0X1", ["error: Alarm lock"]),
            ("$X", ["[Caution: Unlocked]", "ok"]),
        ),
        board="sim_09i",
    ),
    Promise(
        "002 the parser's state",
        (("F500", _OK), ("$G", ["[G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 F500. S0.]", "ok"])),
        board="sim_09i",
    ),
)

_JAPANESE = (
    Promise(
        "003 an arc that cannot be is error:33 or error:34",
        (
            ("F100", _OK),
            ("G2X10Y0I1J0", ["error:33"]),
            ("G2X10R1", ["error:34"]),
            ("G18", _OK),
            ("G2X1Z1R1", _OK),
            ("G17", _OK),
            ("G3X0Y0Z0I-0.5J0", _OK),
        ),
    ),
    Promise(
        "003 G4 in seconds, and not less than none", (("G4P-1", ["error:4"]), ("G4P2.5", _OK))
    ),
    Promise(
        "003 G10 L2 and L20, kept over power, for systems 0 to 6",
        (
            *same_reply("G10L2P2X1Y2Z3 G10L20P0X5 G10L2P6Z-1"),
            ("G10L3P1X0", ["error:20"]),
            ("power", _BANNER),
            (
                "$#",
                [
                    "[G54:-5.000,0.000,0.000]",
                    "[G55:1.000,2.000,3.000]",
                    *_SYSTEMS[2:5],
                    "[G59:0.000,0.000,-1.000]",
                    *_SYSTEMS[6:],
                    "[TLO:0.000]",
                    f"[PRB:{_ZERO}:0]",
                    "ok",
                ],
            ),
            ("G10 L2 P0 X0 Y0 Z0; machine zero", _OK),
        ),
    ),
    Promise(
        "003 G28 by way of a point to the place of G28.1",
        (
            ("G0X3Y4", _OK),
            ("G28.1", _OK),
            ("G0X0Y0", _OK),
            ("G28X10Y0", _OK),
            ("?", ["<Idle|MPos:3.000,4.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>"]),
            ("G30", _OK),
            ("?", [f"<Idle|MPos:{_ZERO}|FS:0,0|Ov:100,100,100>"]),
        ),
    ),
    Promise(
        "003 a probe that meets nothing is an alarm, with G38.3 it is none",
        (
            ("G38.2Z-1F600", ["ALARM:5", f"[PRB:{_ZERO}:0]", "ok"]),
            ("$X", ["[MSG:Caution: Unlocked]", "ok"]),
            ("G38.3Z-2F600", ["[PRB:0.000,0.000,-2.000:0]", "ok"]),
        ),
    ),
    Promise(
        "003 a probe in contact at the start is an alarm",
        (("pin probe", []), ("G38.2Z-1F600", ["ALARM:4", "ok"])),
    ),
    Promise(
        "003 the place of contact is told, and kept for $#",
        (
            ("G38.2Z-1F60", ["[PRB:0.000,0.000,-0.400:1]", "ok"]),
            ("$#", [*_SYSTEMS, "[TLO:0.000]", "[PRB:0.000,0.000,-0.400:1]", "ok"]),
        ),
        switches=(Switch("probe", 2, False, -100),),
    ),
    Promise(
        "003 G43.1 shifts Z, and no other axis",
        (
            *same_reply("G0Z2 G43.1Z0.5 G0Z3"),
            ("?", ["<Idle|MPos:0.000,0.000,3.500|FS:0,0|WCO:0.000,0.000,0.500>"]),
            ("G43.1X1", ["error:37"]),
        ),
    ),
    Promise(
        "003 G53 counts for its own line only",
        (
            ("G10L2P1X5", _OK),
            ("G53 G0 X10 Y20", _OK),
            ("?", ["<Idle|MPos:10.000,20.000,0.000|FS:0,0|WCO:5.000,0.000,0.000>"]),
            ("G0 X10 Y20", _OK),
            ("?", ["<Idle|MPos:15.000,20.000,0.000|FS:0,0|Ov:100,100,100>"]),
            ("G53", _OK),
            ("G0 X10 Y20", _OK),
            ("?", ["<Idle|MPos:15.000,20.000,0.000|FS:0,0>"]),
        ),
    ),
    Promise(
        "003 words without effect, and those that are not there",
        (
            *same_reply("G40 G61 G80 G91.1"),
            *same_reply("G90.1 G41 G42 G61.1 G64 G81", ["error:20"]),
        ),
    ),
    Promise(
        "003 G92 shifts all systems until G92.1",
        (
            ("G92X7", _OK),
            ("G55", _OK),
            ("?", [f"<Idle|MPos:{_ZERO}|FS:0,0|WCO:-7.000,0.000,0.000>"]),
            ("G92.1", _OK),
            ("?", [f"<Idle|MPos:{_ZERO}|FS:0,0|WCO:{_ZERO}>"]),
        ),
    ),
)

_JOGGING = (
    Promise(
        "004 the three examples",
        (
            ("G10L2P1Y2", _OK),
            ("$J=X10.0 Y-1.5F6000", _OK),
            ("?", ["<Idle|MPos:10.000,0.500,0.000|FS:0,0|WCO:0.000,2.000,0.000>"]),
            ("$J=G91 G20 X0.5 F200", _OK),
            ("?", ["<Idle|MPos:22.700,0.500,0.000|FS:0,0|Ov:100,100,100>"]),
            ("$J=G53 Y5.0 F6000", _OK),
            ("?", ["<Idle|MPos:22.700,5.000,0.000|FS:0,0>"]),
            ("$G", ["[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]", "ok"]),
        ),
    ),
    Promise(
        "004 what a jog wants, and what it does not take",
        (
            ("$J=X1", ["error:22"]),
            ("$JX1F10", ["error:3"]),
            *same_reply("$J=G1X1F10 $J=M3X1F10 $J=G93X1F10", ["error:16"]),
            ("$J=X1F10S5", ["error:36"]),
            ("G93", _OK),
            ("$J=X 1 (there) F6000", _OK),
        ),
    ),
    Promise(
        "004 a jog in front of a soft limit is refused without an alarm",
        (("$22=1", _OK), ("$20=1", _OK), ("$J=X1F100", ["error:15"]), ("G0X-1", _OK)),
    ),
    Promise(
        "004 only at rest or in a jog, and not mixed with G-code",
        (
            ("now $J=X50F3000", _OK),
            ("now G0X1", ["error:9"]),
            ("now $J=X60F3000", _OK),
            ("!", []),
            ("G0X1", _OK),
            ("now G1X30F2000", _OK),
            ("now $J=X1F10", ["error:8"]),
        ),
    ),
)

_PROMISES = (*_CZECH, *_PUNCH, *_SPANISH, *_JAPANESE, *_JOGGING)
_WAITS = {"?": "report", "\x18": "banner", "!": "ms 600", "~": "ms 100"}  # what to wait for


def _wait_for(text: str) -> str:
    if text.startswith(("$C", "$RST")) or text in ("$SLP", "G0X1"):
        return "ms 900"
    return "ok" if text.startswith("$") and text not in ("$H",) and text[:2] != "$J" else "idle"


def _talk(promise: Promise, rig: Rig) -> "Iterator[Any]":
    """Say each text of a promise, and compare the lines received."""
    sender = Sender(rig)
    sender.allow(3_600_000)  # ms: an hour for everything
    yield from sender.wait("banner", "")
    sender.take()
    for text, reply in promise.talk:
        yield from _say(rig, sender, text)
        if reply and "[MSG:Reset to continue]" in reply:
            yield from sender.wait("ms 600", "")  # half a second after the alarm
        got = sender.take()
        if reply is not None:
            assert len(got) == len(reply), f"{text!r}: {got}"
            for line, wanted in zip(got, reply, strict=True):
                head, star, tail = wanted.partition("*")
                assert line == wanted or (star and line.startswith(head) and line.endswith(tail))


def _say(rig: Rig, sender: Sender, text: str) -> "Iterator[Any]":
    """Send one text of a promise, or do what it says, and wait as long as this kind needs."""
    if text == "power":
        rig.cycle_power()
        yield rig.now  # let the machine run again
        yield from sender.wait("banner", "")
    elif text.startswith("pin "):
        rig.port.push({text[4:]: True})
        yield rig.ms(5)
    elif text.startswith("now "):
        yield from sender.wait("ok", text[4:] + "\n")
    elif text in _WAITS:
        yield from sender.wait(_WAITS[text], text)
    else:
        yield from sender.wait(_wait_for(text), text + "\n")


def check_promise(promise: Promise) -> Rig:
    """Run the conversation; raise AssertionError if an answer differs from the promise.

    Return the machine. promise.settings: stored lines, like "$22=1", before it is switched on.
    """
    module = load_board(promise.board)
    store = factory_store(module)
    file = next(name for name in store.files if name.startswith("settings"))
    store.files[file] += promise.settings
    rig = Rig(module, store)
    rig.engine.switches += promise.switches
    failed: list[BaseException] = []

    def guarded() -> Iterator[Any]:
        """Keep an exception until the machine has stopped: it must not end the rig's loop."""
        try:
            yield from _talk(promise, rig)
        except BaseException as error:
            failed.append(error)

    rig.run(guarded())
    if failed:
        raise failed[0]
    return rig


@pytest.mark.parametrize("promise", _PROMISES, ids=lambda promise: promise.name)
def test_the_document_keeps_its_promise(promise: Promise) -> None:
    check_promise(promise)


def _promise_named(name: str) -> Promise:
    return next(promise for promise in _PROMISES if promise.name == name)


def test_a_dwell_takes_its_time() -> None:
    """The whole conversation of a promise takes at least its dwells, and at most 0.5 s more."""
    for name, least_ms in (
        # the promise's name, and its shortest duration in ms
        ("000 a dwell may be longer than 6 s", 6500),
        ("003 G4 in seconds, and not less than none", 2500),
    ):
        rig = check_promise(_promise_named(name))
        assert least_ms < rig.now / rig.ticks_per_ms < least_ms + 500


def test_a_feed_is_limited_to_the_highest_rate() -> None:
    """A millimetre at $110=500 (mm/min) takes 0.12 s; without the limit it takes 9 ms."""
    promise = _promise_named("000 F above the highest rate is cut to it")

    def duration_ms(highest_rate: int) -> float:
        settings = ("$120=50000", f"$110={highest_rate}")
        rig = check_promise(promise._replace(settings=settings))
        return float(rig.now / rig.ticks_per_ms)

    assert 100 < duration_ms(500) - duration_ms(60_000) < 125


def test_a_jog_is_reported_and_a_hold_discards_waiting_jogs() -> None:
    rig = check_promise(_promise_named("004 only at rest or in a jog, and not mixed with G-code"))
    assert rig.controller.state.run in (st.IDLE, st.RUN)


def test_the_documents_table_lists_all_promises() -> None:
    text = _TABLE.read_text(encoding="utf-8")
    assert [promise.name for promise in _PROMISES if promise.name[4:] not in text] == []
