"""Judge what an ESP32 has measured, where it differs from an RP2: see judge.py."""

from collections.abc import Iterator

from .row import NOT_SHOWN, Fact, Row

# What stop() leaves of a train is computed from the clock, which may be one step off
# (esp_chip/rmt.py).
_CLOCK_STEPS = 1  # allowed difference between position and count
# So long the engine's own soft interrupt may wait, with others after it, before it hands over.
_LIMIT_US = 3000  # from pulling an input to its callback
_PWM_PERCENT = 4.0  # allowed difference of the share of readings that are high


def stops(facts: list[Fact]) -> Iterator[Row]:
    """Judge RMT's position after a stop.

    The fact has: count, stops; moved, those in motion; exact, those with the counted position;
    worst, the largest difference in steps; late, those with steps afterwards; first, the worst
    case.
    """
    one = facts[0]
    good = one["worst"] <= _CLOCK_STEPS and one["late"] == 0 and one["moved"] > 0
    text = f"{one['count']} stops, half of them made in a soft interrupt, "
    text += f"{one['moved']} of them in motion; "
    text += (
        f"position computed from time: matched the step counter in {one['exact']} stops; largest "
    )
    text += f"difference {one['worst']} steps; no step afterwards"
    if not good:
        text = f"position up to {one['worst']} steps off the counter (the first: {one['first']}), "
        text += f"{one['late']} with steps after the stop, {one['moved']} of {one['count']} moved"
    yield Row("stops at random instants", good, text, one)


def limits(facts: list[Fact]) -> Iterator[Row]:
    """Judge limit inputs that are not wired, pulled by the chip itself."""
    fact = facts[0]
    what = "limit: time to the last step edge"
    if not fact["inputs"]:
        yield Row(what, None, "left out: no LIMIT pin uses the chip's own pull-up", fact)
    elif not fact["shown"]:
        why = (
            "a limit input stays high, because something is wired to it: disconnect that, and "
            "test again"
        )
        yield Row(what, None, NOT_SHOWN + why, fact)
    else:
        yield _limit(what, fact)
    why = "the test program that pulls the pin low is itself held up by the garbage collection"
    yield Row("limit, during a collection: time to the last step edge", None, NOT_SHOWN + why)


def _limit(what: str, fact: Fact) -> Row:
    """Judge the time from pulling a limit input to its callback, and the position after it.

    The fact has: us, these times; missed, limits without a callback; late, those with steps after
    the stop; worst, the largest difference between position and count, in steps.
    """
    times_us = fact["us"]
    is_bad = fact["missed"] or fact["late"] or fact["worst"] > _CLOCK_STEPS
    if not times_us:
        return Row(what, False, f"{fact['missed']} inputs pulled low, none detected", fact)
    mean = sum(times_us) / len(times_us)
    text = f"mean {mean:.0f} us, worst {max(times_us)} us; {len(times_us)} inputs pulled low "
    text += "by the chip"
    if is_bad:
        text += (
            f"; {fact['missed']} not detected, {fact['late']} with steps after the stop, position "
        )
        text += f"up to {fact['worst']} off"
    good = not is_bad and max(times_us) <= _LIMIT_US
    return Row(what, good, text, {**fact, "mean_us": mean, "worst_us": max(times_us)})


def pwm(facts: list[Fact]) -> Iterator[Row]:
    """Judge the spindle's PWM: levels read as fast as Python can, and rising edges counted.

    A fact has: high, the share of readings that were high, in thousandths; looks, their number;
    edges, in a time of `ms`; power, of `full`.
    """
    for fact in facts:
        due = 100 * fact["power"] / fact["full"]
        percent = fact["high"] / 10
        hz = 1000 * fact["edges"] / fact["ms"]
        is_constant = due in (0, 100)
        slack = 0 if is_constant else _PWM_PERCENT
        good = abs(percent - due) <= slack and is_constant == (fact["edges"] == 0)
        what = "spindle PWM after a kill" if fact.get("killed") else f"spindle PWM, {due:g} %"
        text = f"{percent:.1f} % high in {fact['looks']} readings, {hz:.0f} pulses a second"
        yield Row(what, good, text, fact)
