"""Run many futures of one emulated machine, each in a process forked from this one.

A fork is a free snapshot: the common past (power-up, settings, a program on its way) is emulated
once and shared by all. The result of a future is sent as a line of JSON in a pipe.
"""

import json
import os
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from chips import CHIP

# An RP2350 is emulated in another process, which a fork does not copy.
HAVE_FORK = hasattr(os, "fork") and CHIP.name == "rp2040"

_PATIENCE_S = 3600


def forked(do: "Callable[[], None]") -> int:
    """Run do() in a process of its own, which ends afterwards; return its process id."""
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        signal.alarm(_PATIENCE_S)  # a hanging process is ended and has no result
        do()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def results_of(run: "Callable[[Callable[[Any], None]], None]") -> "tuple[list[Any], bool]":
    """Return all results of a forked process and its children, and whether it succeeded."""
    reader, writer = os.pipe()

    def send(result: "Any") -> None:
        os.write(writer, json.dumps(result).encode() + b"\n")  # short enough for one write

    process = forked(lambda: run(send))
    os.close(writer)
    with open(reader, encoding="ascii") as pipe:
        lines = pipe.readlines()
    return [json.loads(line) for line in lines], os.waitpid(process, 0)[1] == 0


@contextmanager
def futures() -> "Iterator[Callable[[Callable[[], None]], None]]":
    """Yield a function that runs a future in its own process, at most one per processor.

    At the end all processes have ended.
    """
    alive: list[int] = []

    def play(do: "Callable[[], None]") -> None:
        if len(alive) >= (os.cpu_count() or 1):
            alive.remove(os.wait()[0])
        alive.append(forked(do))

    yield play
    for process in alive:
        os.waitpid(process, 0)
