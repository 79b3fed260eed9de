"""Measure rows that need the pins of an emulated board, and the interrupt's share.

The interrupt's share can be measured on a real board, too.
"""

from collections.abc import Iterator
from itertools import pairwise

from bench_setup import Bench, inside, reset, set_up
from emulated import DIR, STEP, Board, steps
from on_board import MAIN
from rows import Row
from streaming import figures, idle
from wire import Talk

# These moves take longer than they are measured.
_LONG = {
    "1 axis, 1 kHz": ("G91 G1 X100 F240",),
    "1 axis, 100 kHz": ("G91 G1 X100 F24000",),
    "3 axes, 70 kHz": ("G91 G1 X100 Y90 Z80 F29000",),
    "50 blocks/s": ("G91", *(f"G1 X0.4 Y{0.3 + 0.01 * (k % 3):.2f} F1500" for k in range(14))),
}
_LOOKED_US = 100_000
_BLOCKS_S = (300, 600)
_BLOCK_MM = 0.05
_WAITING = 13

_HELD_HZ = 10_000
_STEPS_MM = 250
_SLOWER = 1.02
_PHASES_US = (0, 2_300, 5_100, 7_700)

_CRUISE_US = 10_000
_FASTEST = (
    *("$110=120000", "$111=120000", "$112=120000"),
    *("$120=40000", "$121=40000", "$122=40000"),
)
_FAST_MM = 46


def share(bench: Bench) -> Iterator[Row]:
    """Yield the pulse engine's interrupt's share of the processor.

    A loop on the board counts its turns for 0.1 s, first idle and then during a move. With short
    blocks it counts for most of the time that 13 of them take; they are planned while a longer
    block runs.
    """
    talk = bench.talk(MAIN)
    idle(talk)
    (idle_turns,) = inside(talk, f"$COUNT={_LOOKED_US}")
    for name, lines in _LONG.items():
        for line in lines:
            talk.ask(line)
        talk.pause_us(30_000)
        (moving_turns,) = inside(talk, f"$COUNT={_LOOKED_US}")
        yield Row(f"interrupt's share, {name}", 100 * (1 - moving_turns / idle_turns), "%")
        _stop(talk)
    for rate in _BLOCKS_S:
        looked_us = round(0.8 * _WAITING / rate * 1e6)
        (idle_turns,) = inside(talk, f"$COUNT={looked_us}")
        moving_turns = _count_short(talk, rate, looked_us)
        share_percent = 100 * (1 - moving_turns / idle_turns)
        yield Row(f"interrupt's share, {rate} blocks/s", share_percent, "%")
        idle(talk)


def _count_short(talk: Talk, rate: int, looked_us: int) -> int:
    """Return the turns of the loop while short blocks run at that rate."""
    feed = _BLOCK_MM * rate
    talk.ask(f"G91 G1 X{0.1 * feed:.2f} F{60 * feed:.0f}")  # lasts 0.1 s
    short = f"X{0.8 * _BLOCK_MM:.3f}Y{0.6 * _BLOCK_MM:.3f}"
    for line in (short,) * (_WAITING + 1):
        talk.ask(line)
    (turns,) = inside(talk, f"$LATER={looked_us}")
    return turns


def _stop(talk: Talk) -> None:
    talk.wire.send(b"!")
    talk.pause_us(60_000)
    reset(talk)


def _recorded(bench: Bench) -> "tuple[Talk, Board]":
    """Return a conversation and its board, with the motor pins recorded."""
    talk, board = bench.talk(MAIN), bench.pico(MAIN)
    if not hasattr(board, "is_recorded"):
        board.is_recorded = True
        board.pico.record([*STEP, *DIR])
    return talk, board


def hold(bench: Bench) -> Iterator[Row]:
    """Yield the time from `!` to the first late step.

    Late is an interval more than 2 % longer. One axis moves at 10 kHz; holds start at different
    phases of segments and main loop.
    """
    talk, board = _recorded(bench)
    delays_us = []
    for phase_us in _PHASES_US:
        talk.ask(f"G91 G1 X20 F{60 * _HELD_HZ / _STEPS_MM:.0f}")
        talk.pause_us(30_000 + phase_us)
        board.pico.edges.clear()
        sent_us = talk.wire.now_us()
        talk.wire.send(b"!")
        talk.pause_us(90_000)
        delays_us.append(_first_late(board) - sent_us)
        reset(talk)
    mean, worst = figures(delays_us)
    yield Row("! to the first slower step, mean", mean, "ms", "held")
    yield Row("! to the first slower step, worst", worst, "ms")


def _first_late(board: Board) -> float:
    """Return the time of the first late step, in us."""
    rises = [us for us, _ in steps(board.pico.edges, 0)]
    allowed = _SLOWER * 1e6 / _HELD_HZ
    return next(b for a, b in pairwise(rises) if b - a > allowed)


def rates(bench: Bench) -> Iterator[Row]:
    """Yield the step rate for a feed that no motor could follow, with $0=3.

    The rate is the mean of 10 ms in the middle of a move. Also: its shortest interval, and whether
    steps, pins and reported position agree.
    """
    talk, board = _recorded(bench)
    for line in _FASTEST:
        talk.ask(line)
    for axes in (1, 2, 3):
        before = _position(board)
        board.pico.edges.clear()
        talk.ask("G91 G1 " + "".join(f"{axis}{_FAST_MM}" for axis in "XYZ"[:axes]) + "F999999")
        idle(talk)
        step_times_us = [[us for us, _ in steps(board.pico.edges, axis)] for axis in range(axes)]
        after = _position(board)
        middle_us = (step_times_us[0][0] + step_times_us[0][-1]) / 2
        gaps_us = [
            b - a
            for times_us in step_times_us
            for a, b in pairwise(times_us)
            if abs(a - middle_us) < _CRUISE_US / 2
        ]
        name = f"{axes} axis" if axes == 1 else f"{axes} axes"
        yield Row(f"step rate, {name}", 1e3 * len(gaps_us) / sum(gaps_us), "kHz each", name)
        yield Row(f"step rate, {name}, shortest interval", min(gaps_us), "us")
        steps_due = _FAST_MM * _STEPS_MM
        wrong = sum(abs(len(times_us) - steps_due) for times_us in step_times_us)
        wrong += sum(abs(b - a - _FAST_MM) > 0.5 / _STEPS_MM for a, b in zip(before, after[:axes]))
        yield Row(f"step rate, {name}, steps missing or reported wrong", wrong)
    board.pico.edges.clear()
    set_up(talk)


def _position(board: Board) -> "list[float]":
    # A ? right after the answer to another one would count as answered by it.
    board.pico.run_us(2_000)
    return [float(x) for x in board.status()["MPos"].split(",")]
