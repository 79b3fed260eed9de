"""Find what may be wrong with a machine from its own reports, and say it in words.

settings_check.py judges settings. values: settings by number.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

from ..boardfile import engines
from ..grbl.settings_file import AXES, Firmware
from ..paths import use_firmware

OK, NOTE, BAD = "ok", "note", "bad"


NEW_MICROPYTHON = "put MicroPython 1.28 on the board: micropython.org/download"
# Messages of the firmware about the user's own Python.
_TRACE = "[MSG:Trace: "
_LEFT_OUT = "[MSG:Custom left out: "
_OF_HANDLER = re.compile(r"\[MSG:Last fault: (M\d+|G[\d.]+|on\.\w+(?:\([^)]*\))?|every \d+): ")
_PLACE = re.compile(r'File "[\w./]+", line \d+')
_FROZEN = re.compile(r"\[MSG:Build: \w+, frozen\]")
_STACK = re.compile(r"\[MSG:Stack: (\d+) of (\d+) bytes used\]")
_STACK_SPARE = 1024  # bytes
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
        text += ": a variant of Grbl; not every check here applies to it"
        return Finding(what, NOTE, text)
    if found.version != "1.1":
        return Finding(what, BAD, text, "current senders need Grbl 1.1: update the firmware")
    if is_ours(found) and found.build < ours:  # builds are dates, YYYYMMDD
        todo = f"install this computer's build of {ours}: ugrbl deploy"
        return Finding(what, NOTE, f"{text} is older than the firmware of this computer", todo)
    is_simulator = is_ours(found) and found.name.split()[1:2] == ["sim"]  # "Grbl sim …"
    return Finding(what, OK, f"{text}: it is the simulator" if is_simulator else text)


def link(found: Firmware) -> list[Finding]:
    """Judge whether Ctrl-X takes effect while the firmware is busy."""
    if not is_ours(found) or _SLOW_RESET not in found.name.split():
        return []
    text = (
        "this MicroPython keeps bytes from USB where the firmware cannot find them: Ctrl-X takes "
        "effect only when the main loop next reads input, and no welcome is sent when a port opens"
    )
    return [Finding("USB", NOTE, text, NEW_MICROPYTHON)]


def frozen(replies: Iterable[str]) -> list[Finding]:
    """Report, from `$I+`, a firmware that is frozen."""
    if not any(_FROZEN.fullmatch(reply) for reply in replies):
        return []
    text = "the firmware is part of the board's MicroPython: a file of `ugrbl uf2 --keep` updates"
    return [Finding("frozen", OK, text + " it")]


def stack(replies: Iterable[str]) -> list[Finding]:
    """Judge the use of the C stack that `$I+` reports; nothing if it is not reported."""
    matches = [match for match in map(_STACK.fullmatch, replies) if match]
    if not matches:
        return []
    used, size = (int(number) for number in matches[-1].groups())
    text = f"{used} of {size} bytes used at most since power-up"
    if size - used >= _STACK_SPARE:
        return [Finding("C stack", OK, text)]
    todo = "report this, and what the machine was doing; until it is mended, run the firmware "
    todo += "without your own Python: an interrupt without free stack stops the machine"
    return [Finding("C stack", NOTE, f"{text}: less than 1 kB is free", todo)]


def drains(replies: Iterable[str]) -> list[Finding]:
    """Judge the underruns that `$I+` reports; nothing if the board does not count them."""
    counts = [int(match[1]) for match in map(_DRAINS.fullmatch, replies) if match]
    if not counts:
        return []
    if not counts[-1]:
        return [
            Finding("drains", OK, "since power-up, no program stopped because lines came too late")
        ]
    return [Finding("drains", NOTE, held_up(counts[-1], "since power-up"), WHY_DRAINED)]


def held_up(times: int, when: str) -> str:
    """Return the number of underruns in words."""
    count = "once" if times == 1 else f"{times} times"
    return f"motion stopped {count} {when} because lines came too late"


WHY_DRAINED = (
    "`ugrbl run FILE --board NAME` names lines that come too fast for the board; if there are "
    "none, the sender is late: let it count characters (not wait for each ok), keep the computer "
    "from sleeping, and use no USB hub"
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
        handlers = [_OF_HANDLER.match(reply) for reply in replies]
        names = "".join(f"{match[1]} has failed\n" for match in handlers if match)
        todo = "correct it: ugrbl custom edit; a push removes this message"
        found.append(Finding("custom.py", NOTE, names + "\n".join(trace), todo))
    return found


def _errors(text: str) -> str:
    """Restore Python's word. The firmware shortens it, because senders would take it for an
    answer."""
    return re.sub(r"Err\b", "Error", text)


def too_old(engine: str, chip: str, version: str) -> str:
    """Return why the engine ("": none) cannot run with this MicroPython; "" if it can, or if that
    is not known. chip: in MicroPython's words."""
    use_firmware()
    from boot import parts

    numbers = release(version)
    return parts.too_old(engine, chip, numbers) if engine and len(numbers) == 2 else ""


def release(version: str) -> tuple[int, ...]:
    """Return the first two numbers of a version, `v1.28.0`; fewer if it has fewer."""
    return tuple(int(number) for number in re.findall(r"\d+", version)[:2])


def micropython(chip: str, version: str) -> list[Finding]:
    """Judge whether a MicroPython at its prompt is new enough for our engines: bad only if it is
    too old for each of them that the chip can run."""
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


def pins_at_rest(pins: str, values: Mapping[int, float]) -> list[Finding]:
    """Judge inputs (their letters in reports) that are active although nothing touches them."""
    if not pins:
        return [Finding("inputs", OK, "no input is active")]
    findings = []
    limits = "".join(letter for letter in pins if letter in AXES)
    if limits:
        needed = values.get(21, 0) or values.get(22, 0)  # hard limits, homing
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
    bouncing = [letter for letter, count in seen.items() if count > 10]  # more often than by hand
    if bouncing:
        text = f"{', '.join(bouncing)} changed very often"
        todo = "noise: shielded wire, a capacitor of 100 nF at the input, a stronger pull-up"
        findings.append(Finding("switches", NOTE, text, todo))
    return findings
