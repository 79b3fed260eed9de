"""How many lines a second boards process; pace.py compares programs with these figures.

They are those of docs/speed.md, in its column with the flash cache; a test compares them. Only a
Pico has been measured.
"""

from typing import Any, NamedTuple

from .chips import CHIPS, processors


class Rates(NamedTuple):
    """The rates of a board for each kind of line, if it did nothing else."""

    plain: float  # lines/s: short moves
    power: float  # lines/s: the same with a new S each, in laser mode
    in_python_ms: float  # a line that kernels leave to Python: an arc, except its chords
    no_words_ms: float  # a comment, or an empty line
    chords: float  # chords of arcs per second

    def line_s(self, kind: str) -> float:
        """Return the seconds for a line of a kind, by the name of a field."""
        figure: float = getattr(self, kind)
        return figure / 1000 if kind.endswith("_ms") else 1 / figure


PICO = Rates(plain=2180, power=1840, in_python_ms=2.13, no_words_ms=0.256, chords=5400)
_MEASURED = "RP2040"
# Bytes a second of an ESP32's serial port.
_UART_BYTES_S = 115_200 / 10


class Intake(NamedTuple):
    """The intake of a board: its rates, whose they are, and bytes a second of its link (0:
    unlimited)."""

    rates: Rates
    whose: str
    bytes_s: float


def intake(board: Any) -> Intake:
    """Return the intake for a board file: a Pico's rates, the only ones there are, and a text that
    says so."""
    chip = CHIPS.get(getattr(board, "CHIP", ""))
    # The processors that the board may have; none for a machine of the simulator.
    names = [chip.processor] if chip else processors(getattr(board, "MPY_ARCH", ""))
    whose = "a Pico"
    if names and _MEASURED not in names:
        whose = f"a Pico (an {names[0]} has not been measured)"
    # With LINK "uart", an ESP32-S3 has native USB, which is fast enough.
    is_serial = getattr(board, "LINK", "usb") == "uart" and "ESP32" in names[:1]
    return Intake(PICO, whose, bytes_s=_UART_BYTES_S if is_serial else 0.0)
