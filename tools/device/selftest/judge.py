"""Judge what the board has measured: one row per check.

A fact is a name and figures (on_board/say.py). Consecutive facts of one kind are judged together.
Edges of a pin in a window are a list: the level at first, then the ticks at which it changes. A
tick of engine and sampler is TICK_US. NOT_SHOWN begins the text of a check that is neither passed
nor failed.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from . import judge_esp as esp
from .row import NOT_SHOWN, Fact, Row

TICK_US = 0.08  # one tick of the engine and of the sampler, in us
_TICK_HZ = 12_500_000
_EXACT_TICKS = 1  # two samples may see the same edge one tick apart
_OF_A_PIO = 4  # motors
_LIMIT_US = 300.0  # from a limit's edge to the last step
_HANG_MS = 500  # from the hang until motors and spindle are off
_REPORT_MS = 300  # reports of a hang come at least so often
_PWM_PERCENT = 2.0  # allowed difference of the duty cycle
_STACK_BYTES = 8192  # size of the C stack
_STACK_SPARE = 2048  # bytes of it that must stay free
# No flash erases faster: 4 kB take at least 45 ms.
_FLASH_US = 5000


def highs(edges: Sequence[int]) -> list[int]:
    """Return the lengths of complete pulses, in ticks."""
    return [b - a for a, b, is_high in _spans(edges) if is_high]


def rises(edges: Sequence[int]) -> list[int]:
    """Return the ticks at which the level rises."""
    return list(edges[1 + edges[0] :: 2])


def falls(edges: Sequence[int]) -> list[int]:
    """Return the ticks at which the level falls."""
    return list(edges[2 - edges[0] :: 2])


def _spans(edges: Sequence[int]) -> Iterator[tuple[int, int, bool]]:
    """Yield the time between each edge and the next one: begin and end in ticks, and whether the
    level is high."""
    level = edges[0]
    for begin, end in pairwise(edges[1:]):
        level = 1 - level
        yield begin, end, level == 1


def _us(ticks: float) -> float:
    """Return ticks in microseconds, to two decimals."""
    return round(ticks * TICK_US, 2)


def _range(ticks: Sequence[int]) -> str:
    """Return the lowest and the highest of these times as text, in microseconds."""
    low, high = _us(min(ticks)), _us(max(ticks))
    return f"{low:g} us" if low == high else f"{low:g} to {high:g} us"


# Checks, by name of their facts (RULES). Each yields rows: name, whether it is passed, text,
# figures. The figures of a fact are those that on_board/ reports by say().


def _board(facts: list[Fact]) -> Iterator[Row]:
    """Report the board; nothing can be wrong with it."""
    fact = facts[0]
    text = f"{fact['name']}, MicroPython {fact['micropython']}, {fact['hz'] / 1e6:g} MHz"
    drivers = "drivers off" if fact["enables"] else "no ENABLE"
    yield Row("board", True, f"{text}, {fact['axes']} axes, {drivers}", fact)


def _watchers(facts: list[Fact]) -> Iterator[Row]:
    """Judge whether the counters see the pins: they must count steps that software has made. If
    they do not, nothing else can be judged."""
    fact = facts[0]
    # levels: of a STEP pin that was set high, then low
    sees_pins = fact["seen"] == fact["made"] and fact["levels"] == [1, 0]
    forward, backward = fact["made"]
    if sees_pins:
        text = f"{forward} steps forward and {backward} backward made by hand were counted"
    else:
        counter = fact.get("who", "PIO 1")
        counts = f"{counter} counted {fact['seen']} of {fact['made']}"
        text = f"{NOT_SHOWN}{counts}: the counter does not see the pins"
    yield Row("watchers see the pins", sees_pins or None, text, fact)  # None: not shown


def _steps(facts: list[Fact]) -> Iterator[Row]:
    """Judge runs there and back (a fact each): position and count of all axes must be as asked
    for, 0 after the way back, and each axis must have been counted."""
    good, total = True, 0
    for run in facts:
        due = 0 if run["back"] else run["asked"]
        total += run["asked"]
        good &= run["rested"] and set(run["position"]) == {due} == set(run["counted"])
    axes = {axis for run in facts for axis in run["motors"]}
    good &= axes == set(range(len(facts[0]["position"])))
    # Each round asks for the same: report the steps of one, there and back.
    total //= sum(not run["back"] for run in facts)
    text = f"{total} on each of {len(axes)} axes, there and back, all counted"
    if not good:
        last = facts[-1]
        text = f"commanded {total}, there and back; position {last['position']}, counted"
        text += f" {last['counted']}" + ("" if last["rested"] else "; motion did not end")
    yield Row(f"steps at {facts[0]['rate']}, all axes", good, text, {"facts": facts})


def _pulses(facts: list[Fact]) -> Iterator[Row]:
    """Judge pulse width, step period and skew, from edges of the step pins in some windows."""
    hz, pulse_us = facts[0]["hz"], facts[0]["us"]
    tracks = [edges for window in facts for edges in window["steps"]]  # of each axis
    widths = [ticks for edges in tracks for ticks in highs(edges)]
    gaps = [b - a for edges in tracks for a, b in pairwise(rises(edges))]
    where = f", {hz / 1000:g} kHz"  # ends the rows' names
    if not widths or not gaps:
        yield Row(f"pulse width{where}", False, "no pulse was seen")
        return
    slack_us = _EXACT_TICKS * TICK_US
    least_us, most_us = min(widths) * TICK_US, max(widths) * TICK_US
    # It may be a tick longer.
    good = pulse_us - slack_us <= least_us and most_us <= pulse_us + 2 * slack_us
    text = f"{_range(widths)}; {pulse_us} asked; {len(widths)} pulses"
    yield Row(f"pulse width{where}", good, text, {"us": [_us(min(widths)), _us(max(widths))]})
    due = _TICK_HZ // hz
    good = all(abs(gap - due) <= _EXACT_TICKS for gap in (min(gaps), max(gaps)))
    text = f"{_range(gaps)}; {_us(due):g} asked; {len(gaps)} periods"
    yield Row(f"step period{where}", good, text, {"us": [_us(min(gaps)), _us(max(gaps))]})
    yield _skew(facts, due, where)


def _skew(facts: list[Fact], due: int, where: str) -> Row:
    """Judge the time between a step of the first axis and the nearest one of each other axis.

    due: ticks of a period. where: end of the row's name.
    """
    # Without the first and the last step, whose counterparts may be outside of the window.
    apart = [
        min((abs(a - b) for b in rises(edges)), default=due)
        for window in facts
        for edges in window["steps"][1:]
        for a in rises(window["steps"][0])[1:-1]
    ]
    if not apart:
        return Row(f"skew between axes{where}", False, "no steps to compare")
    text = f"{_us(max(apart)):g} us at the most; {len(apart)} pairs of steps"
    # The fifth motor's PIO starts up to a tick after the first's.
    pio_ticks = 1 if len(facts[0]["steps"]) > _OF_A_PIO else 0
    good = max(apart) <= _EXACT_TICKS + pio_ticks
    return Row(f"skew between axes{where}", good, text, {"us": _us(max(apart))})


def _turns(facts: list[Fact]) -> Iterator[Row]:
    """Judge hold and set-up: times from the last pulse to a change of direction, and from that to
    the next pulse."""
    hold, setup = [], []  # in ticks
    for window in facts:
        for step, direction in zip(window["steps"], window["dirs"], strict=True):
            for turn in direction[1:]:  # the ticks at which it changes
                hold += [turn - fall for fall in falls(step) if fall <= turn][-1:]  # the last
                setup += [rise - turn for rise in rises(step) if rise >= turn][:1]  # the first
    for what, ticks, asked_us in (
        ("direction hold", hold, facts[0]["hold_us"]),
        ("direction set-up", setup, facts[0]["setup_us"]),
    ):
        if not ticks:
            yield Row(what, False, "no reversal was seen")
            continue
        good = min(ticks) * TICK_US >= asked_us - _EXACT_TICKS * TICK_US
        text = f"shortest time {_us(min(ticks)):g} us in {len(ticks)} reversals; "
        text += f"{asked_us} us required"
        yield Row(what, good, text, {"us": _us(min(ticks)), "asked_us": asked_us})


def _stops(facts: list[Fact]) -> Iterator[Row]:
    """Judge stops at random instants: the position must equal the count, and no step follow."""
    fact = facts[0]
    good = fact["wrong"] == 0 == fact["late"] and fact["count"] > 0
    text = f"{fact['count']} stops, half in an interrupt; position equal to the step count"
    if not good:
        text = (
            f"{fact['wrong']} of {fact['count']} stops with a position other than the step count"
        )
        text += f" (the first: {fact['first']}), {fact['late']} with steps after the stop"
    yield Row("stops at random instants", good, text, fact)


def _starts(facts: list[Fact]) -> Iterator[Row]:
    """Judge short moves from standstill: every step must be made, and each move must end."""
    fact = facts[0]
    good = fact["wrong"] == 0 == fact["stuck"] and fact["count"] > 0
    text = f"{fact['count']} moves, every step made and counted"
    if not good:
        text = f"{fact['wrong']} of {fact['count']} moves wrong (the first: {fact['first']}), "
        text += f"{fact['stuck']} did not end"
    yield Row("starts from rest", good, text, fact)


def _limits(facts: list[Fact]) -> Iterator[Row]:
    """Judge limit inputs, undisturbed and during garbage collections."""
    for fact in facts:
        when = ", during a collection" if fact["collecting"] else ""
        what = f"limit{when}: time to the last step edge"
        if not fact["inputs"]:
            yield Row(what, None, "left out: the board file names no LIMIT", fact)
        elif not fact["shown"]:
            yield Row(
                what, None, NOT_SHOWN + "a pin's interrupt cannot be forced on this chip", fact
            )
        else:
            yield _limit(what, fact)


def _limit(what: str, fact: Fact) -> Row:
    """Judge the time from an edge at a limit input to the last step of any axis.

    The fact has: ticks, these times, -1 if no step followed; missed, limits without an event;
    wrong, stops with a position other than the count; window, ticks that were sampled.
    """
    delays = [max(ticks, 0) for ticks in fact["ticks"]]
    worst_us = _us(max(delays))
    good = fact["missed"] == 0 == fact["wrong"] and worst_us <= _LIMIT_US
    mean_us = _us(sum(delays) / len(delays))
    text = f"mean {mean_us:g} us, worst {worst_us:g} us; {len(delays)} interrupts forced"
    if max(delays) > 0.95 * fact["window"]:  # steps to the end of the sampled window
        text = f"more than {_us(fact['window']):g} us; {len(delays)} interrupts forced"
    if fact["missed"] or fact["wrong"]:
        text += f"; {fact['missed']} not detected, {fact['wrong']} positions unlike the step count"
    return Row(what, good, text, {**fact, "mean_us": mean_us, "worst_us": worst_us})


def duty_percent(edges: Sequence[int]) -> float:
    """Return the duty cycle over whole periods; 0 or 100 for a constant level."""
    begins = rises(edges)  # of the periods
    if len(begins) < 2:
        return 100.0 * edges[0]
    high = [end - begin for begin, end, is_high in _spans(edges) if is_high and begin < begins[-1]]
    return 100 * sum(high) / (begins[-1] - begins[0])


def _pwm(facts: list[Fact]) -> Iterator[Row]:
    """Judge the spindle's PWM: the duty cycle at the pin against the power set."""
    if "power" not in facts[0]:
        why = (
            "the board file names no SPINDLE_PWM"
            if facts[0]["asked"]
            else "not allowed; --yes allows it"
        )
        yield Row("spindle PWM", None, f"left out: {why}")
        return
    for fact in facts:
        due = 100 * fact["power"] / fact["full"]
        percent = duty_percent(fact["edges"])
        good = abs(percent - due) <= _PWM_PERCENT
        if due in (0, 100):  # a constant level, without any edge
            good = fact["edges"] == [due // 100]
        yield Row(f"spindle PWM, {due:g} %", good, f"{percent:.1f} % at the pin", fact)


def _dark(facts: list[Fact]) -> Iterator[Row]:
    """Judge whether the spindle's output is off after a limit, or after a kill."""
    for fact in facts:
        what = fact["what"].replace("pwm", "spindle PWM")
        if fact.get("shown") is False:
            yield Row(what, None, NOT_SHOWN + "a pin's interrupt cannot be forced on this chip")
        else:
            good = fact["edges"] == [0]  # low, without any edge
            text = (
                "off, and stays so" if good else f"{duty_percent(fact['edges']):.1f} % at the pin"
            )
            yield Row(what, good, text, fact)


def _save(facts: list[Fact]) -> Iterator[Row]:
    """Judge how long interrupts are off while settings are written to flash: how much later than
    due (beat_us) a periodic interrupt came at worst."""
    fact = facts[0]
    off_us = max(fact["longest_us"] - fact["beat_us"], 0)
    what = "settings save: interrupts off"
    if fact["wrong"]:
        text = f"{fact['wrong']} of {fact['count']} saves read back with other values"
        yield Row(what, False, text, fact)
    elif off_us < _FLASH_US:
        text = f"{NOT_SHOWN}{off_us / 1000:g} ms; no flash is as fast as that"
        yield Row(what, None, text, fact)
    else:
        text = (
            f"{off_us / 1000:.1f} ms at the most, of {fact['took_ms']} ms; {fact['count']} saves"
        )
        yield Row(what, off_us < 1_000_000, text, fact)  # below a second


def _hang(facts: list[Fact]) -> Iterator[Row]:
    """Judge how soon motors and spindle are off after the main loop hangs, and the use of stack.

    The last report counts. It has ms, its time since the hang began, and when the last step came
    and the spindle was last on. A time close to `ms` means that they were never off.
    """
    last = facts[-1]
    moved = last["steps"] > 0
    good = moved and last["last_step_ms"] <= _HANG_MS
    text = f"last step {max(last['last_step_ms'], 0)} ms after the main loop has hung"
    if last["last_step_ms"] > last["ms"] - _REPORT_MS:
        text = f"motors turned on for all of {last['ms']} ms"
    yield Row("hang on purpose: steps", good, text if moved else "nothing moved", last)
    if last["pwm"]:  # the spindle was allowed to run
        off_ms = last["last_high_ms"]
        text = f"off {max(off_ms, 0)} ms after the main loop has hung"
        if off_ms > last["ms"] - _REPORT_MS:
            text = f"on for all of {last['ms']} ms"
        yield Row("hang on purpose: spindle", off_ms <= _HANG_MS, text)
    used = last["used_stack"]
    if used is None:  # not measured on this chip
        return
    text = f"{used} bytes of {_STACK_BYTES} in a simple move"
    good = used <= _STACK_BYTES - _STACK_SPARE
    yield Row("C stack: deepest use", good, text, {"used_bytes": used})


RULES: dict[str, Callable[[list[Fact]], Iterator[Row]]] = {
    "board": _board,
    "watchers": _watchers,
    "steps": _steps,
    "pulses": _pulses,
    "turns": _turns,
    "stops": _stops,
    "starts": _starts,
    "limits": _limits,
    "pwm": _pwm,
    "pwm after a limit": _dark,
    "pwm after a kill": _dark,
    "save": _save,
    "hang": _hang,
    "stops by the clock": esp.stops,
    "limits pulled": esp.limits,
    "pwm looked at": esp.pwm,
}


def judge(facts: list[Fact]) -> Iterator[Row]:
    """Yield the rows for facts of one kind; their "what" names the kind."""
    yield from RULES[facts[0]["what"]](facts)


def belongs(fact: Fact, before: Fact) -> bool:
    """Return whether the two facts are judged together."""
    return all(fact.get(key) == before.get(key) for key in ("what", "hz"))
