"""Hold the machine when a signal ends the program that sends to it."""

import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from .send import Stream

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Ctrl-C, a request to end, a closed terminal


@contextmanager
def stopping_signals(stream: Stream) -> Iterator[None]:
    """Within this context, the signals first hold the machine: see Stream.interrupt()."""
    # of stdin, stdout and stderr
    terminals = [number for number in range(3) if os.isatty(number)]

    def hold(number: int, _frame: FrameType | None) -> None:
        if signal.Signals(number).name == "SIGHUP":
            _redirect_to_nothing(terminals)
        stream.interrupt(number)

    before = {}
    for name in _SIGNALS:
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number and signal.getsignal(number) is not signal.SIG_IGN:  # nohup makes it ignored
            before[number] = signal.signal(number, hold)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _redirect_to_nothing(terminals: Sequence[int]) -> None:
    """Redirect a closed terminal to /dev/null: an exception must not keep us from stopping."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in terminals:
        os.dup2(nothing, number)
