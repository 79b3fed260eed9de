"""A self-test from beginning to end, over whatever speaks to the board."""

import json
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from ..deploy import About, DeployError
from . import program
from .judge import Fact, Row, belongs, judge
from .program import Amounts, Chip

_OLDEST = (1, 26)  # Timer(hard=True)
_MARK = "= "
# What the slowest parts may take, with some to spare.
_CHECKS_S = 300.0
_HANG_S = 20.0

# What the board file says that decides what may be done.
WIRING = """
def wiring():
    try:
        import board
    except ImportError:
        return None
    return [getattr(board, name, None) for name in ("ENGINE", "ENABLE", "SPINDLE_PWM")]
"""


class Wiring(NamedTuple):
    """Of the board file on the board."""

    engine: str
    enable: Any
    spindle_pwm: int | None


class Board(Protocol):
    """A board with MicroPython; every method may raise DeployError."""

    def enter(self) -> None:
        """Get the prompt, with all memory free; a machine in motion is not disturbed."""

    def about(self) -> About:
        """What is on it."""

    def wiring(self) -> Wiring | None:
        """What its board file says; None without the firmware."""

    def run(self, script: str, heard: Callable[[str], None], seconds: float) -> str:
        """Run this at the prompt, tell of each line; returns what it has failed with, or ""."""

    def until_restart(self, script: str, heard: Callable[[str], None], seconds: float) -> bool:
        """The same with what never ends; whether the firmware has started anew by itself."""

    def start(self) -> None:
        """From the prompt back to the firmware."""


class Hearer:
    """Lines of the board in, rows out, as soon as all facts of a kind are there."""

    def __init__(self, tell: Callable[[Row], None]) -> None:
        self._tell = tell
        self._facts: list[Fact] = []
        self.ended = False

    def line(self, text: str) -> None:
        """One line that the board has said."""
        if not text.startswith(_MARK):
            return
        what, brace, rest = text[len(_MARK) :].partition(" {")
        fact = {"what": what, **json.loads("{" + rest)} if brace else {"what": what}
        if self._facts and not belongs(fact, self._facts[0]):
            self.close()
        if what == "end":
            self.ended = True
        else:
            self._facts.append(fact)

    def close(self) -> None:
        """Nothing more of this kind comes."""
        facts, self._facts = self._facts, []
        for row in judge(facts) if facts else ():
            self._tell(row)


def look(board: Board) -> tuple[Chip, Wiring]:
    """Who is there; DeployError in words where it cannot be tested."""
    board.enter()
    about = board.about()
    try:
        chip = _chip(about)
        wiring = board.wiring()
        if wiring is None:
            raise DeployError("the firmware is not on the board", "ugrbl deploy, then test again")
        if wiring.engine != "pio":
            raise DeployError(f"ENGINE {wiring.engine!r} is none that can be tested", "")
    except DeployError:
        board.start()
        raise
    return chip, wiring


def _chip(about: About) -> Chip:
    if "RP2040" not in about.machine and "RP2350" not in about.machine:
        raise DeployError(
            f"{about.machine} is no RP2040 or RP2350: nothing on it can watch its pins",
            "a Raspberry Pi Pico, or a board with its chip, can be tested",
        )
    version = tuple(int(part) for part in about.version.split(".")[:2])
    if version < _OLDEST:
        oldest = ".".join(str(part) for part in _OLDEST)
        raise DeployError(
            f"MicroPython {about.version} is older than {oldest}: it has no hard timers",
            "put a newer one on the board (micropython.org/download), then test again",
        )
    return program.RP2350 if "RP2350" in about.machine else program.RP2040


def check(
    board: Board, chip: Chip, amounts: Amounts, pwm: bool, seed: int, tell: Callable[[Row], None]
) -> None:
    """All checks at a board that look() has found fit; the firmware runs again at the end."""
    hearer = Hearer(tell)
    wrong = board.run(program.checks(chip, amounts, pwm, seed), hearer.line, _CHECKS_S)
    hearer.close()
    if wrong or not hearer.ended:
        tell(Row("all checks were made", False, wrong.strip().rpartition("\n")[2] or "they ended"))
    board.enter()
    is_back = board.until_restart(program.hang(chip, pwm), hearer.line, _HANG_S)
    hearer.close()
    text = "the watchdog has started the firmware anew" if is_back else "it did not come back"
    tell(Row("hang on purpose: watchdog", is_back, text))
