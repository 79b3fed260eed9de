"""Find what may be wrong with a machine from its own reports, and say it in words."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

from ..boardfile import engines
from ..grbl.settings_file import AXES, Firmware
from ..paths import use_firmware

OK, NOTE, BAD = "ok", "note", "bad"

# Highest step rates of one axis if the pulse engine is not known.
_GRBL_ON_AVR_HZ = 30_000
_UGRBL_HZ = 100_000
# The name of the pulse engine, and the rate that the board states.
_IDENTITY = re.compile(r"Grbl(?:HAL)?(?: ([a-z]\w*))?(?: (\d+)Hz)?\b")
# Factory values of Grbl 1.1h, which hardly any machine can use.
_STOCK = {100: 250.0, 110: 500.0, 120: 10.0, 130: 200.0}
_LONG_RAMP_S = 2.0

NEW_MICROPYTHON = "put MicroPython 1.28 on the board: micropython.org/download"
# Messages of the firmware about the user's own Python.
_TRACE = "[MSG:Trace: "
_LEFT_OUT = "[MSG:Custom left out: "
_OF_HANDLER = re.compile(r"\[MSG:Last fault: (M\d+|G[\d.]+|on\.\w+(?:\([^)]*\))?|every \d+): ")
_PLACE = re.compile(r'File "[\w./]+", line \d+')
_FROZEN = re.compile(r"\[MSG:Build: \w+, frozen\]")
_STACK = re.compile(r"\[MSG:Stack: (\d+) of (\d+) bytes used\]")
_STACK_SPARE = 1024
_DRAINS = re.compile(r"\[MSG:Drains: (\d+)\]")
# In the firmware's name if it reads USB in the slow way.
_SLOW_RESET = "slow-reset"

PINS = {
    "X": "limit switch X",
    "Y": "limit switch Y",
    "Z": "limit switch Z",
    "A": "limit switch A",
    "P": "probe",
    "D": "safety door",
    "H": "hold button",
    "R": "reset button",
    "S": "start button",
}


@dataclass
class Finding:
    """The result of one check. todo: the next step, if there is one."""

    what: str
    verdict: str
    text: str
    todo: str = ""

    def as_json(self) -> dict[str, str]:
        """Return the finding for `ugrbl doctor --json`."""
        return asdict(self)


def firmware(found: Firmware, ours: str) -> Finding:
    """Judge which firmware answers. ours: the build that this package would deploy."""
    what = "firmware"
    if not found.version:
        return Finding(what, BAD, "it does not report its version", "update the firmware")
    text = f"{found}{', ' + found.name if found.name else ''}"
    if is_relative(found):
        return Finding(
            what, NOTE, f"{text}: a variant of Grbl; not every check here applies to it"
        )
    if found.version != "1.1":
        return Finding(what, BAD, text, "current senders need Grbl 1.1: update the firmware")
    if is_ours(found) and found.build < ours:
        todo = f"this computer has the build of {ours}: ugrbl deploy"
        return Finding(what, NOTE, f"{text} is older than the firmware of this computer", todo)
    is_simulator = is_ours(found) and found.name.split()[1:2] == ["sim"]
    return Finding(what, OK, f"{text}: it is the simulator" if is_simulator else text)


def link(found: Firmware) -> list[Finding]:
    """Judge whether Ctrl-X takes effect while the firmware is busy."""
    if not is_ours(found) or _SLOW_RESET not in found.name.split():
        return []
    text = "this MicroPython stores bytes from USB in an unknown place: Ctrl-X takes effect only "
    text += "at the firmware's next turn, and the welcome is not sent when a port opens"
    return [Finding("USB", NOTE, text, NEW_MICROPYTHON)]


def frozen(replies: Iterable[str]) -> list[Finding]:
    """Report, from `$I+`, a firmware that is frozen."""
    if not any(_FROZEN.fullmatch(reply) for reply in replies):
        return []
    text = (
        "the firmware is part of the board's MicroPython: a file of `ugrbl uf2 --keep` updates it"
    )
    return [Finding("frozen", OK, text)]


def stack(replies: Iterable[str]) -> list[Finding]:
    """Judge the use of the C stack that `$I+` reports; nothing if it is not reported."""
    matches = [match for match in map(_STACK.fullmatch, replies) if match]
    if not matches:
        return []
    used, size = (int(number) for number in matches[-1].groups())
    text = f"{used} of {size} bytes used at most since power-up"
    if size - used >= _STACK_SPARE:
        return [Finding("C stack", OK, text)]
    todo = "report it with what the machine was doing, and run the firmware without changes of "
    todo += "your own: an interrupt without free stack stops the machine"
    return [Finding("C stack", NOTE, f"{text}: less than 1 kB is free", todo)]


def drains(replies: Iterable[str]) -> list[Finding]:
    """Judge the underruns that `$I+` reports; nothing if the board does not count them."""
    counts = [int(match[1]) for match in map(_DRAINS.fullmatch, replies) if match]
    if not counts:
        return []
    if not counts[-1]:
        return [Finding("drains", OK, "no program was held up for want of lines since power-up")]
    return [Finding("drains", NOTE, held_up(counts[-1], "since power-up"), WHY_DRAINED)]


def held_up(times: int, when: str) -> str:
    """Return the number of underruns in words."""
    return f"motion stopped {'once' if times == 1 else f'{times} times'} for want of lines {when}"


WHY_DRAINED = (
    "`ugrbl run FILE --board NAME` names lines that come faster than a board takes them; if "
    "there are none, the sender is late: let it count characters (not wait for each ok), and the "
    "computer neither sleep nor share a USB hub"
)


def is_fault(text: str) -> bool:
    """Return whether a text has the position in the firmware of an exception."""
    return _PLACE.search(text) is not None


def fault(message: str) -> Finding:
    """Return the finding for a fault that the firmware reports."""
    todo = "report it, with these lines and what the machine was doing; after a reset (Ctrl-X) it "
    todo += "works again: its position should be right, but check it before a move"
    return Finding("fault", BAD, _errors(message), todo)


def faults(replies: Iterable[str]) -> list[Finding]:
    """Return the last fault since power-up that `$I+` reports."""
    messages = [reply for reply in replies if reply.startswith("[MSG:Last fault: ")]
    return [fault(reply) for reply in messages if not _OF_HANDLER.match(reply)]


def custom(replies: Sequence[str]) -> list[Finding]:
    """Judge what `$I+` reports of the user's own Python: that it was left out, and the traceback
    of the last handler that failed, which may be from before power-up."""
    found = []
    for reply in replies:
        if reply.startswith(_LEFT_OUT):
            todo = "correct it: ugrbl custom edit; until then the machine runs without it"
            found.append(Finding("custom.py", BAD, _errors(reply[len(_LEFT_OUT) : -1]), todo))
    trace = [_errors(reply[len(_TRACE) : -1]) for reply in replies if reply.startswith(_TRACE)]
    if trace:
        who = [_OF_HANDLER.match(reply) for reply in replies]
        names = "".join(f"{match[1]} has failed\n" for match in who if match)
        todo = "correct it: ugrbl custom edit; a push removes this message"
        found.append(Finding("custom.py", NOTE, names + "\n".join(trace), todo))
    return found


def _errors(text: str) -> str:
    """Restore Python's word. The firmware shortens it, because senders would take it for an
    answer."""
    return re.sub(r"Err\b", "Error", text)


def too_old(engine: str, chip: str, version: str) -> str:
    """Return why the engine cannot run with this MicroPython; "" if it can. chip: in MicroPython's
    words."""
    use_firmware()
    from boot import parts

    numbers = release(version)
    return parts.too_old(engine, chip, numbers) if engine and len(numbers) == 2 else ""


def release(version: str) -> tuple[int, ...]:
    """Return the first two numbers of a version, `v1.28.0`; fewer if it has fewer."""
    return tuple(int(number) for number in re.findall(r"\d+", version)[:2])


def micropython(chip: str, version: str) -> list[Finding]:
    """Judge whether a MicroPython at its prompt is new enough for our engines."""
    possible = [name for name, engine in engines.engines().items() if engine.runs_on(chip)]
    reasons = [too_old(engine, chip, version) for engine in possible]
    bad = [reason for reason in reasons if reason]
    verdict = BAD if len(bad) == len(reasons) else NOTE
    return [Finding("MicroPython", verdict, reason, NEW_MICROPYTHON) for reason in bad]


def is_relative(found: Firmware) -> bool:
    """Return whether it is a firmware derived from Grbl that has more functions."""
    name = found.name.lower()
    return not is_ours(found) and ("hal" in name or "fluidnc" in name)


def is_ours(found: Firmware) -> bool:
    """Return whether it is ugrbl, which has its name in $I, where Grbl has none."""
    return found.version == "1.1" and found.name.startswith("Grbl")


def most_hz(found: Firmware, pulse_us: float) -> float:
    """Return the highest step rate to expect of one axis, with pulses of that length."""
    identity = _IDENTITY.match(found.name)
    if identity is None or not is_ours(found):
        return _GRBL_ON_AVR_HZ
    engine, stated = identity.groups()
    all_engines = engines.engines()
    engine_hz = all_engines[engine].most_hz if engine in all_engines else _UGRBL_HZ
    pulse_hz = 1_000_000 / (pulse_us + 1)
    if engine == "pio" and not stated:
        return pulse_hz  # also above most_hz, with STEP_PULSE_MIN_US
    return min(int(stated) if stated else engine_hz, pulse_hz)


def settings(values: Mapping[int, float], found: Firmware) -> list[Finding]:
    """Judge which settings cannot work, or will disappoint."""
    findings = [finding for check in _CHECKS for finding in check(values, found)]
    return findings or [Finding("settings", OK, "the settings have no contradictions")]


def pins_at_rest(pins: str, values: Mapping[int, float]) -> list[Finding]:
    """Judge inputs that are active although nothing touches them."""
    if not pins:
        return [Finding("inputs", OK, "no input is active")]
    findings = []
    limits = "".join(letter for letter in pins if letter in AXES)
    if limits:
        needed = values.get(21, 0) or values.get(22, 0)
        todo = (
            "move off the switches; if they are open, they are wired the other way round: "
            f"$5={0 if values.get(5) else 1}"
        )
        if not needed:
            todo += ", or there are none: then leave $21 and $22 at 0"
        text = f"limit inputs active at rest: {limits}"
        findings.append(Finding("limits", BAD if needed else NOTE, text, todo))
    if "P" in pins:
        todo = f"take the probe off the work; if it is off: $6={0 if values.get(6) else 1}"
        findings.append(Finding("probe", NOTE, "the probe reads contact", todo))
    for letter in "DHRS":
        if letter in pins:
            todo = "release it; if it is released, look for a wire to ground, or noise"
            findings.append(Finding("inputs", BAD, f"the {PINS[letter]} is active", todo))
    return findings


def pins_pressed(seen: Mapping[str, int], values: Mapping[int, float], axes: int) -> list[Finding]:
    """Judge the switches that were pressed. seen: how often each letter became active."""
    if not seen:
        todo = "check wiring and the pins of the board file; was anything pressed?"
        return [Finding("switches", NOTE, "no input has changed", todo)]
    names = ", ".join(f"{PINS.get(letter, letter)} ({count}×)" for letter, count in seen.items())
    findings = [Finding("switches", OK, f"seen: {names}")]
    missing = [letter for letter in AXES[:axes] if letter not in seen]
    if missing and values.get(22, 0):
        text = f"never seen, though homing ($22) needs them: {', '.join(missing)}"
        findings.append(Finding("switches", NOTE, text, "press each; check wiring and pins"))
    bouncing = [letter for letter, count in seen.items() if count > 10]
    if bouncing:
        text = f"{', '.join(bouncing)} changed very often"
        todo = "noise: shielded wire, a capacitor of 100 nF at the input, a stronger pull-up"
        findings.append(Finding("switches", NOTE, text, todo))
    return findings


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
        speed = values.get(110 + axis, 0) / 60
        acceleration = values.get(120 + axis, 0)
        if acceleration <= 0:
            continue
        seconds = speed / acceleration
        distance = speed * seconds
        if distance > values.get(130 + axis, 0):
            text = f"{letter} cannot reach its highest rate within its travel"
            todo = f"raise the acceleration, ${120 + axis}"
            yield Finding("acceleration", NOTE, text, todo)
        elif seconds > _LONG_RAMP_S:
            text = f"{letter} takes {seconds:.1f} s to its highest rate: slow in every corner"
            todo = f"raise ${120 + axis} in steps until it loses steps, then halve it"
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
            yield Finding(
                "homing", BAD, "soft limits ($20) are on without homing ($22)", "set $22=1"
            )
        return
    off = values.get(27, 0)
    if off <= 0:
        todo = "set it so that the switch opens, 1 to 3 mm"
        yield Finding("homing", BAD, "the pull-off ($27) is 0: homing ends in ALARM:8", todo)
    for axis, letter in _axes(values):
        if off >= values.get(130 + axis, 0) > 0:
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
        yield Finding("spindle", BAD, text, "S would be full power or none: correct them")
    if values.get(32):
        text = "laser mode ($32) is on: G0 is dark, and M3 does not wait for a spindle"
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
