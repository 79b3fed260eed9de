"""How many lines a second boards take: the figures that a program's own are held against.

They are those of docs/speed.md, its column with the flash cache; a test compares. Only a Pico has
been measured.
"""

from typing import Any, NamedTuple

from .chips import CHIPS, processors


class Rates(NamedTuple):
    """What a board takes of each kind, if it had nothing else to do."""

    plain: float  # lines/s: short moves
    power: float  # lines/s: the same with a new S each, in laser mode
    in_python_ms: float  # a line that kernels leave to Python: an arc, but for its chords
    no_words_ms: float  # a comment, or an empty line
    chords: float  # a second, of arcs

    def line_s(self, kind: str) -> float:
        """Seconds for a line of a kind, by the name of a field."""
        figure: float = getattr(self, kind)
        return figure / 1000 if kind.endswith("_ms") else 1 / figure


PICO = Rates(plain=2090, power=1780, in_python_ms=2.0, no_words_ms=0.256, chords=5340)
_MEASURED = "RP2040"
# What an ESP32's serial port carries.
_UART_BYTES_S = 115_200 / 10


class Intake(NamedTuple):
    """What a board takes in: its rates, whose they are, and bytes a second of its link, or 0."""

    rates: Rates
    whose: str
    bytes_s: float


def intake(board: Any) -> Intake:
    """That of a board file; who names none is told of a Pico."""
    chip = CHIPS.get(getattr(board, "CHIP", ""))
    names = [chip.processor] if chip else processors(getattr(board, "MPY_ARCH", ""))
    whose = "a Pico"
    if names and _MEASURED not in names:
        whose = f"a Pico (an {names[0]} has not been measured)"
    # An ESP32-S3 has USB of its own there.
    is_serial = getattr(board, "LINK", "usb") == "uart" and names[0] == "ESP32"
    return Intake(PICO, whose, _UART_BYTES_S if is_serial else 0.0)
