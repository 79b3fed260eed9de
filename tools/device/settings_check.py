"""Find settings that cannot work, or will disappoint, and say it in words.

values: settings by number. With i for the axis: $100+i steps/mm, $110+i highest rate in mm/min,
$120+i acceleration in mm/s2, $130+i travel in mm. found: what the firmware says of itself in $I.
"""

import re
from collections.abc import Callable, Iterator, Mapping

from ..boardfile import engines
from ..grbl.settings_file import AXES, Firmware
from .checkup import BAD, NOTE, OK, Finding, is_ours

# Highest step rates of one axis if the pulse engine is not known.
_GRBL_ON_AVR_HZ = 30_000
_UGRBL_HZ = 100_000
# The name of the pulse engine, and the rate that the board states.
_IDENTITY = re.compile(r"Grbl(?:HAL)?(?: ([a-z]\w*))?(?: (\d+)Hz)?\b")
# Factory values of Grbl 1.1h, which hardly any machine can use.
_STOCK = {100: 250.0, 110: 500.0, 120: 10.0, 130: 200.0}
_LONG_RAMP_S = 2.0  # from standstill to the highest rate


def most_hz(found: Firmware, pulse_us: float) -> float:
    """Return the highest step rate to expect of one axis, with pulses of that length."""
    identity = _IDENTITY.match(found.name)
    if identity is None or not is_ours(found):
        return _GRBL_ON_AVR_HZ
    engine, stated_hz = identity.groups()
    all_engines = engines.engines()
    engine_hz = all_engines[engine].most_hz if engine in all_engines else _UGRBL_HZ
    pulse_hz = 1_000_000 / (pulse_us + 1)  # between two pulses is 1 us
    if engine == "pio" and not stated_hz:
        return pulse_hz  # also above most_hz, with STEP_PULSE_MIN_US
    return min(int(stated_hz) if stated_hz else engine_hz, pulse_hz)


def settings(values: Mapping[int, float], found: Firmware) -> list[Finding]:
    """Judge which settings cannot work, or will disappoint."""
    findings = [finding for check in _CHECKS for finding in check(values, found)]
    return findings or [Finding("settings", OK, "the settings have no contradictions")]


def _axes(values: Mapping[int, float]) -> Iterator[tuple[int, str]]:
    """Yield number and letter of each axis that has a $100, steps per mm, and so on."""
    for axis, letter in enumerate(AXES):
        if 100 + axis in values:
            yield axis, letter


Findings = Iterator[Finding]

# Each check gets the settings by number, and the firmware that has them.


def _positive(values: Mapping[int, float], found: Firmware) -> Findings:
    """Find settings of an axis that are 0 or less, with which it does not move."""
    names = {100: "steps/mm", 110: "highest rate", 120: "acceleration", 130: "travel"}
    for axis, letter in _axes(values):
        for base, name in names.items():
            if values.get(base + axis, 0) <= 0:
                number = f"${base + axis}"
                text = f"{number}: the {name} of {letter} is {values.get(base + axis, 0):g}"
                yield Finding("settings", BAD, text, f"set {number} to the machine's value")


def _step_rates(values: Mapping[int, float], found: Firmware) -> Findings:
    """Find axes whose highest rate needs more steps per second than the firmware makes."""
    pulse_us = values.get(0, 10)
    highest_hz = most_hz(found, pulse_us)
    for axis, letter in _axes(values):
        hz = values[100 + axis] * values.get(110 + axis, 0) / 60
        if hz > highest_hz:
            mm_min = highest_hz * 60 / values[100 + axis]
            text = (
                f"{letter} at its highest rate needs {hz / 1000:.1f} kHz; "
                f"{highest_hz / 1000:.0f} kHz is possible with pulses of {pulse_us:g} us"
            )
            todo = f"lower $11{axis} to {mm_min:.0f}, or take fewer microsteps"
            yield Finding("step rate", BAD, text, todo)


def _ramps(values: Mapping[int, float], found: Firmware) -> Findings:
    """Find axes whose acceleration is too low for their highest rate."""
    for axis, letter in _axes(values):
        speed = values.get(110 + axis, 0) / 60  # in mm/s
        acceleration = values.get(120 + axis, 0)
        if acceleration <= 0:
            continue
        seconds = speed / acceleration
        distance = speed * seconds  # to speed up, and as much to slow down: half of it each
        if distance > values.get(130 + axis, 0):
            text = f"{letter} cannot reach its highest rate within its travel"
            todo = f"raise the acceleration, ${120 + axis}"
            yield Finding("acceleration", NOTE, text, todo)
        elif seconds > _LONG_RAMP_S:
            text = f"{letter} takes {seconds:.1f} s "
            text += "to reach its highest rate: it will be slow in every corner"
            todo = f"raise ${120 + axis} until the motor loses steps, then set half of that"
            yield Finding("acceleration", NOTE, text, todo)


def _stock(values: Mapping[int, float], found: Firmware) -> Findings:
    """Find settings that are all still those of a new Grbl."""
    axes = list(_axes(values))
    if axes and all(values.get(base + i) == v for base, v in _STOCK.items() for i, _ in axes):
        text = "steps/mm, rates, accelerations and travels are factory settings"
        todo = "set the settings $100 through $132 for this machine; first steps/mm ($100 to $102)"
        yield Finding("settings", NOTE, text, todo)


def _homing(values: Mapping[int, float], found: Firmware) -> Findings:
    """Find settings of homing and limits that contradict each other."""
    if not values.get(22):
        if values.get(20):
            text = "soft limits ($20) are on without homing ($22)"
            yield Finding("homing", BAD, text, "set $22=1")
        return
    pull_off_mm = values.get(27, 0)
    if pull_off_mm <= 0:
        todo = "set it so that the switch opens, 1 to 3 mm"
        yield Finding("homing", BAD, "the pull-off ($27) is 0: homing ends in ALARM:8", todo)
    for axis, letter in _axes(values):
        if pull_off_mm >= values.get(130 + axis, 0) > 0:
            text = f"the pull-off ($27) is longer than the travel of {letter}"
            yield Finding("homing", BAD, text, f"lower $27 or correct $13{axis}")
    if values.get(24, 0) > values.get(25, 0):
        text = "homing searches the switch ($25) slower than it locates it ($24)"
        yield Finding("homing", NOTE, text, "exchange the two values")
    if not values.get(21):
        text = "homing is on and hard limits ($21) are off: a crash is not stopped"
        yield Finding("homing", NOTE, text, "set $21=1 once the switches are free of noise")


def _spindle(values: Mapping[int, float], found: Firmware) -> Findings:
    """Find wrong spindle speeds, and mention the laser mode."""
    if values.get(30, 1) <= values.get(31, 0):
        text = "the highest spindle speed ($30) is not above the lowest ($31)"
        yield Finding(
            "spindle", BAD, text, "any S would be full power or none: correct $30 and $31"
        )
    if values.get(32):
        text = "laser mode ($32) is on: the beam is off in G0, and M3 does not wait for a spindle"
        yield Finding("spindle", NOTE, text, "right for a laser; with a spindle: $32=0")


def _motion(values: Mapping[int, float], found: Firmware) -> Findings:
    """Find unusual values of junction deviation, arc tolerance and report units."""
    if not 0 < values.get(11, 0.01) <= 0.5:
        text = f"junction deviation ($11) is {values[11]:g} mm"
        yield Finding("settings", NOTE, text, "0.01 to 0.05 is usual")
    if not 0.0005 <= values.get(12, 0.002) <= 0.1:
        text = f"arc tolerance ($12) is {values[12]:g} mm"
        yield Finding("settings", NOTE, text, "0.002 is usual")
    if values.get(13):
        text = "reports are in inches ($13): some senders take them for millimetres"
        yield Finding("settings", NOTE, text, "set $13=0")


_CHECKS: tuple[Callable[[Mapping[int, float], Firmware], Findings], ...] = (
    _positive,
    _step_rates,
    _ramps,
    _stock,
    _homing,
    _spindle,
    _motion,
)
