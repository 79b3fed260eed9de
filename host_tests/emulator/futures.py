"""Many futures of one emulated machine: each is played in a process forked from this one.

A fork is a snapshot for nothing: what went before (power-up, settings, a program on its way) is
emulated once and shared by all. What a future finds comes back as a line of JSON in a pipe.
"""

import json
import os
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from chips import CHIP

# An RP2350 is emulated in another process, which a fork does not double.
HAVE_FORK = hasattr(os, "fork") and CHIP.name == "rp2040"

_PATIENCE_S = 3600


def forked(do: "Callable[[], None]") -> int:
    """Do it in a process of its own, which ends with it. Returns the number of the process."""
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        signal.alarm(_PATIENCE_S)  # a process that hangs is ended, and has not told anything
        do()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def told(tell: "Callable[[Callable[[Any], None]], None]") -> "tuple[list[Any], bool]":
    """All that a forked process, and those it forks, hand to the function it is given; and
    whether it has come to its end."""
    reader, writer = os.pipe()

    def hand_over(found: "Any") -> None:
        os.write(writer, json.dumps(found).encode() + b"\n")  # short enough to go in one piece

    process = forked(lambda: tell(hand_over))
    os.close(writer)
    with open(reader, encoding="ascii") as pipe:
        lines = pipe.readlines()
    return [json.loads(line) for line in lines], os.waitpid(process, 0)[1] == 0


@contextmanager
def futures() -> "Iterator[Callable[[Callable[[], None]], None]]":
    """A function that plays a future in a process of its own, as many at once as there are
    processors. At its end all have come to theirs."""
    alive: list[int] = []

    def play(do: "Callable[[], None]") -> None:
        if len(alive) >= (os.cpu_count() or 1):
            alive.remove(os.wait()[0])
        alive.append(forked(do))

    yield play
    for process in alive:
        os.waitpid(process, 0)
