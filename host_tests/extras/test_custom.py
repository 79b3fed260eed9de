"""Test custom.py: the user's own Python, which can never make the machine lose its position.

bench(text) is a machine with this custom.py. cnc.say() powers it up and sends texts, each with
what to wait for: "ok" (an answer), "idle", "banner" or "ms 100" (100 ms); it returns the replies
to each text. lines() are texts that wait for "ok". Then cnc.heard has what handlers have added to
their list `heard`, cnc.mm the motors' position, cnc.outputs a bit per output, cnc.power the
spindle's PWM, cnc.greeting the lines at power-up.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from base import errors
from extras.gcode_text import clean
from hypothesis import given
from hypothesis import strategies as some
from talk.lines import LineReader
from talk.lines import clean as read_line
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

_STEPS_PER_MM = 250  # of the board sim
_STOPPING_MM = 500**2 / 3600 / 2 / 10 + 0.5  # from F500, with 10 mm/s2
_PINS = {"OUTPUTS": {"vacuum": 20, "air": 21}, "INPUTS": {"sensor": 22}}


class Bench:
    """A machine with this text as custom.py, and a sender.

    heard: items that its handlers have added to the list of that name; mm: final position of the
    motors, from the steps made; outputs, power: outputs that are on.
    """

    def __init__(self, folder: Path, name: str, text: str) -> None:
        """Write the module `name` with this text; a board on the simulator has it as CUSTOM."""
        (folder / f"{name}.py").write_text(text)
        board = ModuleType("board")
        vars(board).update(vars(load_board("sim")), CUSTOM=name, **_PINS)
        self.store = factory_store(load_board("sim"))
        self.rig = Rig(board, self.store)
        self._name = name
        self.sender = Sender(self.rig)
        self.sender.allow(3_600_000)  # ms for all waits

    @property
    def heard(self) -> "list[Any]":
        return list(sys.modules[self._name].heard)

    def say(self, *talk: "tuple[str, str] | Callable[[], object]") -> "list[list[str]]":
        """Send texts given as (text, what to wait for), or call functions; return the replies.

        What to wait for is as in Sender.wait(): "ok", "idle", "banner", or "ms 100" for 100 ms.
        There is one list of replies per text, and none for a function.
        """
        replies: list[list[str]] = []

        def script() -> Iterator[Any]:
            """Wait for the welcome, go through `talk`, and note the final state."""
            yield from self.sender.wait("banner", "")
            yield self.rig.ms(100)  # handlers of the start have run
            self.greeting = self.sender.take()  # lines received at power-up
            for each in talk:
                if callable(each):
                    each()
                    continue
                text, how = each
                yield from self.sender.wait(how, text)
                replies.append(self.sender.take())
            steps = self.rig.scratch
            self.rig.engine.position(steps)  # fills it
            self.mm = [step / _STEPS_PER_MM for step in steps]
            self.outputs = self.rig.port.own_outputs
            self.power = self.rig.port.spindle_pwm

        self.rig.run(script())
        return replies


def lines(*texts: str) -> "list[tuple[str, str]]":
    return [(text + "\n", "ok") for text in texts]


_count = iter(range(10**9))


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> "Callable[[str], Bench]":
    """Return a maker of benches, each with a module of its own name."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))

    def make(text: str) -> Bench:
        head = "from ugrbl import mcode, gcode, on, every, Refuse, Refused\nheard = []\n"
        return Bench(tmp_path, f"custom_{next(_count)}", head + text)

    return make


Make = Callable[[str], Bench]


# Reading


def test_words_get_their_numbers_by_name_after_motion_has_ended(bench: Make) -> None:
    """An upper-case letter in "Pq" is required, a lower-case one optional."""
    cnc = bench(
        """
@mcode(100, "Pq")
def vacuum(m, P, Q=7):
    heard.append((P, Q, m.position().x))
@gcode(81.1)
def g(m):
    heard.append("81.1")
"""
    )
    assert cnc.say(*lines("G0X5", "M100 P2", "N7 m100 p1.5 q3", "G81.1"))[1:] == [["ok"]] * 3
    assert cnc.heard == [(2.0, 7, 5.0), (1.5, 3.0, 5.0), "81.1"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("def x(:", "SyntaxErr"),
        ("1 / 0", "line 3, in <module>: ZeroDivisionErr"),
        ("@mcode(3)\ndef spindle(m): pass", "M3 is already in use"),
        ("@gcode(0)\ndef rapid(m): pass", "G0 is already in use"),
        ("@mcode(100)\ndef a(m): pass\n@mcode(100)\ndef b(m): pass", "M100 is already in use"),
        ("@on.nothing\ndef a(m): pass", "there is no event on.nothing"),
        ('@on.input("door")\ndef a(m, closed): pass', "no input named door"),
        ("@every(0)\ndef a(m): pass", "every: 0 is not a number of milliseconds"),
        ("import nowhere_at_all", "nowhere_at_all"),
    ],
)
def test_unreadable_file_is_left_out_and_reported_with_the_cause(
    bench: Make, text: str, reason: str
) -> None:
    """A faulty file adds no word, not even the sound M199 before the fault. The machine works."""
    cnc = bench("@mcode(199)\ndef first(m): heard.append(1)\n" + text)
    replies = cnc.say(("G0X1\n", "idle"), *lines("M199", "$I"))
    messages = [line for line in cnc.greeting if line.startswith("[MSG:Custom left out: ")]
    # The text begins in line 5 of the file, after two lines of the fixture and two of M199.
    assert len(messages) == 1 and reason in messages[0].replace("line 5", "line 3")
    assert replies[:2] == [["ok"], [f"error:{errors.GCODE_UNSUPPORTED_COMMAND}"]]
    assert messages[0] in replies[2]  # $I repeats it
    # A sender must not take the message for an answer.
    assert "ok" not in messages[0] and "error" not in messages[0].lower()


def test_check_mode_checks_words_and_runs_nothing(bench: Make) -> None:
    cnc = bench('@mcode(100, "P")\ndef a(m, P): heard.append(P)\n@on.spindle\ndef s(m, *_): 1/0')
    replies = cnc.say(*lines("$C", "M100P1", "M3S100", "M100", "M101P1"))
    assert [answer[-1] for answer in replies] == ["ok", "ok", "ok", "error:28", "error:20"]
    assert cnc.heard == []


@given(some.text("gGxX10.;() /$-\t", max_size=60))
def test_line_of_a_handler_is_read_like_a_senders(text: str) -> None:
    reader = LineReader(128, 80, lambda _: None)
    reader.feed(bytearray(text.encode() + b"\n"), len(text) + 1)
    length = read_line(*reader.memory()) >> 2
    assert clean(text) == reader.line[:length] + b"\0"


# Events


def test_pulses_have_the_given_width_and_end_with_a_reset(bench: Make) -> None:
    """Pulses of m.pwm() (duty P at 500 Hz) and m.servo() (P in us), and m.out(), which ends them.

    A failing handler and a reset switch all outputs off.
    """
    cnc = bench(
        "@mcode(100, 'P')\ndef share(m, P): m.pwm('vacuum', P, hz=500)\n"
        "@mcode(101, 'P')\ndef turn(m, P): m.servo('air', P); heard.append(m.is_on('air'))\n"
        "@mcode(102, 'P')\ndef switch(m, P): m.out('vacuum', P)\n"
    )
    port = cnc.rig.port
    # Each time: number of the output (0 vacuum, 1 air) -> (Hz, duty with 65535 for 1).
    pulses: list[Any] = []

    def note_pulses() -> None:
        pulses.append(dict(port.own_pulses))

    replies = cnc.say(
        *lines("M100P0.5", "M101P1500"),
        note_pulses,
        *lines("M102P1", "M101P0"),
        note_pulses,
        *lines("M100P0.25", "M100P1.5", "?"),
        note_pulses,
        ("\x18", "idle"),
        *lines("$X", "M102P1"),
        note_pulses,
    )
    # Servo pulses of 1500 us in periods of 20 ms: 0.075 * 65535 = 4915.
    assert pulses[0] == {0: (500, 32768), 1: (50, 4915)} and cnc.heard == [True, False]
    assert pulses[1] == {0: (500, 65535), 1: (50, 0)}
    assert pulses[2] == {}, "a failure leaves no output on"
    assert (
        "share must be 0 to 1" in "".join(replies[5]) and replies[5][1] == "ALARM:34"
    )  # M100P1.5
    assert pulses[3] == {0: (500, 65535)} and cnc.outputs == 1  # only vacuum, bit 0


def test_t_of_a_custom_word_selects_no_tool(bench: Make) -> None:
    """T7 of M100 T7 is an argument of the custom word: T5 stays the selected tool."""
    cnc = bench(
        '@mcode(100, "T")\ndef word(m, T): heard.append(("word", m.tool, T))\n'
        "@on.tool_select\ndef select(m, tool): heard.append(tool)\n"
        "@on.tool_change\ndef change(m, tool): heard.append(('change', tool))\n"
    )
    cnc.say(*lines("T4", "T5M6", "M100T7", "G1X1F500", "M6"))
    assert cnc.heard == [4, 5, ("change", 5), ("word", 5, 7.0), ("change", 5)]


def test_every_event_has_its_values(bench: Make) -> None:
    """One handler per event records the event's name and values; the talk causes all of them."""
    names = (
        "startup after_reset after_unlock after_homing state_change tool_select tool_change "
        "probe_done spindle coolant program_paused program_done alarm"
    ).split()
    cnc = bench(
        "".join(
            f"@on.{name}\ndef h_{name}(m, *values): heard.append(({name!r}, *map(str, values)))\n"
            for name in names
        )
    )
    cnc.say(
        *lines("T4", "T5M6", "M3S200", "M8", "M5", "G38.3Z-1F500"),
        ("$J=G91X1F900\n", "idle"),
        ("M0\n", "ms 200"),
        ("~", "idle"),
        ("M30\n", "ok"),
        ("\x18", "idle"),
        ("$22=1\n", "ok"),
        ("G38.2X-1F500\n", "ms 2000"),  # nothing touched: alarm 5
        ("$X\n", "ok"),
    )
    # state_change and alarm occur many times: they are tested by samples below.
    events = [event for event in cnc.heard if event[0] not in ("state_change", "alarm")]
    assert events == [
        ("startup",),
        ("tool_select", "4"),
        ("tool_select", "5"),
        ("tool_change", "5"),
        ("spindle", "M3", "200.0"),
        ("coolant", "True", "False"),
        ("spindle", "M5", "0.0"),
        ("probe_done", "None"),
        ("program_paused",),
        ("spindle", "M5", "0.0"),
        ("coolant", "False", "False"),
        ("program_done",),
        ("after_reset",),
        ("probe_done", "None"),
        ("after_unlock",),
    ]
    assert ("alarm", "5") in cnc.heard
    assert ("state_change", "Idle", "Jog") in cnc.heard
    assert ("state_change", "Idle", "Hold") in cnc.heard


def test_handlers_may_use_custom_words_and_fire_events(bench: Make) -> None:
    """m.g() runs other custom words and fires events, whose handlers run before it returns."""
    cnc = bench(
        """
@mcode(100, "P")
def own(m, P):
    heard.append(P)
@mcode(101)
def calls(m):
    m.g("M100 P3")
    m.g("T2")
    heard.append(m.tool)
    m.g("M3 S100")
    heard.append("after M3")
    m.home()
    heard.append("home")
@on.tool_select
def select(m, tool): heard.append(("T", tool))
@on.spindle
def spindle(m, word, rpm): heard.append(word)
@on.after_homing
def homed(m): heard.append("homed")
"""
    )
    for motor, axis in enumerate("xyz"):
        # A limit switch that closes above 500 steps (2 mm), for m.home().
        cnc.rig.engine.switches.append(Switch(f"limit_{axis}", motor, True, 500))
    replies = cnc.say(*lines("$22=1", "$X", "M101", "$N0=M100P7"))  # $N0 runs its line at once
    assert replies[2] == replies[3] == ["ok"]
    assert cnc.heard == [3.0, ("T", 2), 2, "M3", "after M3", "homed", "home", 7.0]


def test_line_waits_for_the_handlers_of_the_line_before(bench: Make) -> None:
    """X is still 1 after 0.5 s in the handler of M3: G0X2 has not begun."""
    cnc = bench(
        """
@on.spindle
def delay(m, word, rpm):
    m.wait(0.5)
    heard.append(("on", m.position().x))
"""
    )
    cnc.say(("G0X1\nM3S100\nG0X2\n", "idle"))
    assert cnc.heard == [("on", 1.0)] and cnc.mm[0] == 2


def test_word_may_run_with_the_motion_before_it(bench: Make) -> None:
    """With sync=False the word runs where motion reaches it, without a stop."""
    cnc = bench(
        """
@mcode(62, "P", sync=False)
def on_(m, P):
    m.out("vacuum", P)
    heard.append((m.position().x, m.modes()[0]))
"""
    )
    moves = "".join(f"G1X{x}F500\n" for x in (1, 2))
    cnc.say(("G91\n", "ok"), (moves + "M62P1\n" + "G1X3\nG1X1\n", "idle"))
    ((x_mm, _),) = cnc.heard
    # G91: M62 is after 1 + 2 mm of 1 + 2 + 3 + 1 mm. Output bit 0 is vacuum.
    assert abs(x_mm - 3) < 0.5 and cnc.mm[0] == 7 and cnc.outputs == 1


def test_inputs_and_timers_call_handlers_and_a_report_gets_a_field(bench: Make) -> None:
    """The sensor is pin 22. A report has a field with the number of timer ticks."""
    cnc = bench(
        """
@on.input("sensor")
def sensor(m, closed):
    heard.append(closed)
ticks = [0]
@every(50)
def tick(m):
    ticks[0] += 1
@on.report
def field(m):
    return "Tk:%d" % ticks[0]
"""
    )
    push = cnc.rig.port.push
    replies = cnc.say(
        *lines("G4P1"),
        lambda: push({"pin_22": True}),
        ("", "ms 100"),
        lambda: push({"pin_22": False}),
        ("", "ms 100"),
        ("?", "ms 20"),
        ("?", "ms 20"),
    )
    assert cnc.heard == [True, False]
    # One tick per 50 ms: of about 1.3 s there are 26.
    assert 18 <= int(replies[-1][0].partition("Tk:")[2].rstrip(">")) <= 40


# Failures


def failing(kind: str) -> str:
    """Return custom.py whose M100 fails with this statement, after a move by X3.

    With tool 9 selected, its timer fails in the same way as soon as Y is above 2 mm.
    """
    return f"""
@mcode(100)
def word(m):
    m.g("G91 G0 X3")
    {kind}
@every(10)
def timer(m):
    if m.tool == 9 and m.position().y > 2:
        {kind}
"""


@pytest.mark.parametrize(
    "kind", ["1 / 0", "raise ValueError('ok error')", "m.g('G1 X1 Y')", "heard[5]", "nothing()"]
)
def test_failing_word_lets_motion_end_and_stops_the_spindle(bench: Make, kind: str) -> None:
    """M100 moves by X3 (see failing()), then fails: X3 is reached, and the spindle is off."""
    cnc = bench(failing(kind))
    cnc.say(("M3S100\n", "ok"), ("M100\n", "ms 3000"), ("?", "ms 20"))
    assert cnc.mm[0] == 3 and not cnc.power
    text = "\n".join(map(str, cnc.sender.take()))  # after the replies that say() has returned
    assert not text


def test_failure_message_is_no_answer_and_names_the_line(bench: Make) -> None:
    """The message has no "ok" or "error", although the exception's text does. Line 7 fails: the
    fixture adds two lines before the text of failing()."""
    cnc = bench(failing("raise ValueError('ok error')"))
    (replies,) = cnc.say(("M100\n", "ms 3000"))
    (message,) = [line for line in replies if line.startswith("[MSG:M100: custom_")]
    assert "line 7, in word" in message and "ok" not in message and "error" not in message
    assert (
        replies.index(message)
        < replies.index("ALARM:34")
        < replies.index("[MSG:'$H'|'$X' to unlock]")
    )
    # The traceback is stored in a file of its own.
    assert "custom" in cnc.rig.store.files and "ValueError" in cnc.rig.store.files["custom"][-1]


def test_failure_during_motion_stops_smoothly_and_loses_no_step(bench: Make) -> None:
    """The timer fails at Y2: Y stops with its acceleration; the report is what the motors did."""
    cnc = bench(failing("1 / 0"))
    replies = cnc.say(("T9\n", "ok"), ("G1Y9F500\n", "ms 5000"), ("$X\n", "ok"), ("?", "ms 20"))
    assert "ALARM:34" in replies[1] and 2 < cnc.mm[1] < 2 + _STOPPING_MM
    reported = replies[3][0].partition("MPos:")[2].split("|")[0].split(",")
    assert [float(mm) for mm in reported] == pytest.approx(cnc.mm, abs=0.001)


@pytest.mark.parametrize("call", ['m.g("G0X1")', "m.wait(1)", 'm.ask("?")', "m.wait_motion()"])
def test_handler_during_motion_may_neither_move_nor_wait(bench: Make, call: str) -> None:
    cnc = bench(f"@on.state_change\ndef s(m, old, new):\n    if new == 'Run':\n        {call}")
    (replies,) = cnc.say(("G0X5\n", "ms 3000"))
    assert "ALARM:34" in replies and any("neither move nor wait" in line for line in replies)


def test_refusal_refuses_only_its_line(bench: Make) -> None:
    cnc = bench('@mcode(100)\ndef a(m): raise Refuse("close the door")')
    replies = cnc.say(*lines("M100", "G0X1"))
    assert replies == [["[MSG:close the door]", "error:3"], ["ok"]]


def test_question_in_an_alarm_ends_its_handler(bench: Make) -> None:
    """m.ask() waits in a hold, which an alarm does not allow. Without an answer, the statements
    after it must not run."""
    cnc = bench(
        "@on.after_reset\ndef r(m):\n    if m.state == 'Alarm':\n"
        "        m.ask('hands away?')\n        m.out('vacuum', 1)"
    )
    cnc.say(("G1X9F500\n", "ms 300"), ("\x18", "ms 2000"))
    assert cnc.outputs == 0


def test_refused_tool_change_keeps_the_tool(bench: Make) -> None:
    """T5 M6 is refused by the handler: afterwards m.tool is still 2."""
    cnc = bench(
        """
@on.tool_change
def change(m, tool):
    if tool > 4: raise Refuse("there is no tool %d" % tool)
@mcode(100)
def tell(m): m.message("tool %d" % m.tool)
"""
    )
    replies = cnc.say(*lines("T2M6", "T5M6", "M100"))
    assert replies[1:] == [["[MSG:there is no tool 5]", "error:3"], ["[MSG:tool 2]", "ok"]]


@pytest.mark.parametrize(
    ("program", "handler", "power", "modes"),
    [
        ("G0", "G91 G1 X1 F600", 0, "G0 G54 G17 G21 G90 G94 M3 M9 T0 F900 S500"),
        ("G1", "G91 G0 X1", 128, "G1 G54 G17 G21 G90 G94 M3 M9 T0 F900 S500"),
        ("G1", "S1000", 255, "G1 G54 G17 G21 G90 G94 M3 M9 T0 F900 S1000"),
        ("G1", "S0", 0, "G1 G54 G17 G21 G90 G94 M3 M9 T0 F900 S0"),
    ],
)
def test_laser_is_what_the_modes_say_after_saved(
    bench: Make, program: str, handler: str, power: int, modes: str
) -> None:
    """m.saved() restores F and motion mode, not S. power: PWM; G0 has the laser off.

    program: motion mode before M100; handler: line that M100 executes; modes: of $G afterwards.
    """
    cnc = bench(f'@mcode(100)\ndef a(m):\n    with m.saved():\n        m.g("{handler}")')
    cnc.store.files["settings"].append("$32=1")  # laser mode
    replies = cnc.say(*lines(f"F900 {program}", "M3S500", "M100", "G4P0.1", "$G"))
    assert cnc.power == power and f"[GC:{modes}]" in replies[-1]


def test_laser_stays_dark_after_failed_probing_in_saved(bench: Make) -> None:
    """The block ends in ALARM:5, and G1 with M3, which it would restore, would light the laser."""
    cnc = bench('@mcode(100)\ndef a(m):\n    with m.saved():\n        m.probe("Z-2 F600")')
    cnc.store.files["settings"].append("$32=1")  # laser mode
    replies = cnc.say(*lines("G1 F900 M3 S500"), ("M100\n", "ms 60000"), *lines("$G"))
    assert "ALARM:5" in replies[-2] and cnc.power == 0
    assert "[GC:G38.2 G54 G17 G21 G90 G94 M3 M9 T0 F900 S500]" in replies[-1]


def test_handler_during_motion_has_no_line_to_refuse(bench: Make) -> None:
    cnc = bench('@every(10)\ndef a(m):\n    if m.position().x > 1: raise Refuse("no")')
    replies = cnc.say(("G1X9F500\nG1X0\n", "ms 3000"))
    assert "ALARM:34" in replies[0] and not [line for line in replies[0] if "error" in line]


def test_slow_handler_is_reported_once(bench: Make) -> None:
    """A timer handler takes 60 ms each time, of a simulated second; there is one message."""
    cnc = bench(
        """
@every(100)
def slow(m):
    rig.pass_time(rig.ms(60))
"""
    )

    def pass_rig_to_module() -> None:
        sys.modules[cnc._name].rig = cnc.rig  # type: ignore[attr-defined]

    cnc.rig.on_built = pass_rig_to_module
    replies = cnc.say(("", "ms 1000"))
    received = cnc.greeting + replies[0]
    assert [line for line in received if "every 100 ran for 60 ms" in line] == [
        "[MSG:every 100 ran for 60 ms without calling a method of m]"
    ]


# Reset at any time


@pytest.mark.parametrize("after_ms", [*range(0, 1500, 70)])
def test_reset_ends_a_handler_anywhere(bench: Make, after_ms: int) -> None:
    """M100 moves, waits, catches exceptions, and asks: a reset must end it at any of these."""
    cnc = bench(
        """
@mcode(100)
def long(m):
    with m.saved():
        m.g("G91 G1 X1 F900")
        try:
            m.wait(0.3)
        except Exception:
            pass
        m.out("vacuum", 1)
        m.g("G1 X-1")
        m.wait_for("sensor", seconds=0.4)
        m.ask("Go on?")
    heard.append("end")
"""
    )
    replies = cnc.say(
        ("M100\n", f"ms {after_ms}"),
        ("\x18", "ms 1500"),
        ("$X\n", "ok"),
        ("G91G1X2F900\n", "idle"),
    )
    assert "Grbl 1.1h" in str(replies[1]) and cnc.heard == []
    assert cnc.outputs == 0, "a reset switches outputs off"
    # The last line moves X by 2 mm from where the reset has stopped it, at 0 to 1 mm.
    assert replies[3] == ["ok"] and -0.1 < cnc.mm[0] - 2 < 1.1


# Persistent values


def test_values_are_written_while_idle_and_survive_a_power_cut(bench: Make) -> None:
    """m.keep is not written to flash during motion, which a write would delay."""
    cnc = bench(
        """
@mcode(100, "P")
def keep(m, P):
    m.keep["number"] = P
    m.keep["text"] = "a b"
@mcode(101)
def tell(m):
    heard.append((m.keep["number"], m.keep["text"], "no" in m.keep, m.keep.get("no", 5)))
"""
    )
    cnc.say(("M100P3\nG1X9F500\n", "ms 300"))
    assert "keep" not in cnc.rig.store.files, "it moves"
    # The second say() powers up a new machine with the same store.
    cnc.say(("M100P4\n", "ok"), ("", "ms 50"), cnc.rig.cycle_power)
    cnc.say(*lines("M101"))
    assert cnc.heard[-1] == (4.0, "a b", False, 5)


def test_keep_accepts_only_numbers_and_texts(bench: Make) -> None:
    cnc = bench('@mcode(100)\ndef a(m): m.keep["x"] = [1]')
    (replies,) = cnc.say(("M100\n", "ms 500"))
    assert any("neither a number nor a text" in line for line in replies)
