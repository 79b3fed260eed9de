"""A self-test from beginning to end, over any connection to a board."""

import json
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from ..deploy import About, DeployError
from . import program
from .judge import belongs, judge
from .program import Amounts, AnyChip, Esp
from .row import Fact, Row

_OLDEST = (1, 26)  # MicroPython with all that the tests need
_MARK = "= "  # begins the lines of on_board/say.py: "= stops {figures in JSON}"
# Time limits, longer than the slowest parts take.
_CHECKS_S = 300.0
_HANG_S = 20.0

# On an RP2, the clock takes a machine of PIO 0 and PIO 1, and at least one must count.
_MOST_MOTORS = 6

# The options of the board file that decide which checks are allowed.
WIRING = """
def wiring():
    try:
        import board
    except ImportError:
        return None
    said = [getattr(board, name, None) for name in ("ENGINE", "ENABLE", "SPINDLE_PWM")]
    motors = len(getattr(board, "STEP", ())) + (getattr(board, "TOOL", "") == "laser")
    try:
        from esp32 import PCNT
    except ImportError:
        return said + [False, motors]
    return said + [True, motors]
"""


class Wiring(NamedTuple):
    """What the board file on the board says about pins."""

    engine: str
    enable: Any
    spindle_pwm: int | None
    has_pcnt: bool = False  # pulse counters
    motors: int = 0  # including a laser's beam, which takes a machine as a motor does


class Board(Protocol):
    """A board with MicroPython. Every method may raise DeployError."""

    def enter(self) -> None:
        """Enter the prompt with all memory free. A machine in motion is not disturbed."""

    def about(self) -> About:
        """Return the chip, the MicroPython and the frozen firmware."""

    def wiring(self) -> Wiring | None:
        """Return the wiring in its board file; None without the firmware."""

    def run(self, script: str, heard: Callable[[str], None], seconds: float) -> str:
        """Run a script at the prompt and pass on each line. Returns its traceback, or ""."""

    def until_restart(self, script: str, heard: Callable[[str], None], seconds: float) -> bool:
        """Run a script that never ends, and pass on each line. Returns whether the firmware has
        restarted by itself."""

    def start(self) -> None:
        """Leave the prompt and start the firmware."""


class Hearer:
    """Converts lines from the board to rows, as soon as all facts of a kind are complete."""

    def __init__(self, tell: Callable[[Row], None]) -> None:
        self._tell = tell
        self._facts: list[Fact] = []
        self.ended = False

    def line(self, text: str) -> None:
        """Process one line from the board; all but facts are ignored."""
        if not text.startswith(_MARK):
            return
        what, brace, figures = text[len(_MARK) :].partition(" {")
        fact = {"what": what, **json.loads("{" + figures)} if brace else {"what": what}
        if self._facts and not belongs(fact, self._facts[0]):
            self.close()
        if what == "end":
            self.ended = True
        else:
            self._facts.append(fact)

    def close(self) -> None:
        """Judge the collected facts; no more of this kind follow."""
        facts, self._facts = self._facts, []
        for row in judge(facts) if facts else ():
            self._tell(row)


def look(board: Board) -> tuple[AnyChip, Wiring]:
    """Enter the prompt, and return chip and wiring of the board. DeployError if it cannot be
    tested; the firmware then runs again."""
    board.enter()
    about = board.about()
    try:
        chip = _chip(about)
        wiring = board.wiring()
        if wiring is None:
            raise DeployError("the firmware is not on the board", "ugrbl deploy, then test again")
        _check_countable(about, wiring, chip)
    except DeployError:
        board.start()
        raise
    return chip, wiring


def _chip(about: About) -> AnyChip:
    """Return the chip; DeployError if it, or its MicroPython, cannot be tested."""
    # By a part of the machine's name, the longer ones first. None: it cannot be tested.
    chips: dict[str, AnyChip | None] = {
        "RP2350": program.RP2350,
        "RP2040": program.RP2040,
        "ESP32S3": program.ESP32_S3,
        "ESP32C": None,
        "ESP32S2": None,
        "ESP32": program.ESP32,
    }
    name = about.machine.replace("-", "")
    chip = next((chips[key] for key in chips if key in name), None)
    if chip is None:
        raise DeployError(
            f"{about.machine} is no RP2040, RP2350, ESP32 or ESP32-S3: the steps of other chips "
            "cannot be counted",
            "a board with one of these chips can be tested",
        )
    version = tuple(int(part) for part in about.version.split(".")[:2])
    if version < _OLDEST:
        oldest = ".".join(str(part) for part in _OLDEST)
        lacks = "esp32.PCNT" if isinstance(chip, Esp) else "hard timers"
        raise DeployError(
            f"MicroPython {about.version} is older than {oldest}: it has no {lacks}",
            "put a newer one on the board (micropython.org/download), then test again",
        )
    return chip


def _check_countable(about: About, wiring: Wiring, chip: AnyChip) -> None:
    """Raise DeployError if nothing on the board can count the steps of its engine."""
    if isinstance(chip, Esp) and wiring.engine == "i2s":
        raise DeployError(
            "ENGINE 'i2s' makes steps in external shift registers, where the chip cannot count "
            "them",
            "only a board with ENGINE 'rmt' can be tested",
        )
    if wiring.engine != ("rmt" if isinstance(chip, Esp) else "pio"):
        raise DeployError(
            f"the self-test cannot count steps of ENGINE {wiring.engine!r}",
            "use ENGINE 'pio' on an RP2 chip, 'rmt' on an ESP32",
        )
    if not isinstance(chip, Esp) and wiring.motors > _MOST_MOTORS:
        raise DeployError(
            f"{wiring.motors} motors (a laser's beam counts as one) leave no free state machine "
            "of PIO 1 to count steps",
            f"a board file with at most {_MOST_MOTORS} motors can be tested",
        )
    if isinstance(chip, Esp) and not wiring.has_pcnt:
        raise DeployError(
            f"the MicroPython on {about.machine} has no esp32.PCNT: nothing on it can count steps",
            "put the one of micropython.org/download on the board, then test again",
        )


def check(
    board: Board,
    chip: AnyChip,
    amounts: Amounts,
    pwm: bool,
    seed: int,
    tell: Callable[[Row], None],
) -> None:
    """Run all checks at a board that look() has accepted. The firmware runs again at the end.

    pwm: the spindle's output may be used. seed: of the random times. tell: called with each row.
    """
    hearer = Hearer(tell)
    traceback = board.run(program.checks(chip, amounts, pwm, seed), hearer.line, _CHECKS_S)
    hearer.close()
    if traceback or not hearer.ended:
        last_line = traceback.strip().rpartition("\n")[2]
        tell(Row("all checks were made", False, last_line or "they ended"))
    board.enter()
    is_back = board.until_restart(program.hang(chip, pwm), hearer.line, _HANG_S)
    hearer.close()
    text = (
        "the watchdog has started the firmware anew"
        if is_back
        else "the board did not start again"
    )
    tell(Row("hang on purpose: watchdog", is_back, text))
