"""Measure as a sender does: lines per second, and how long answers take."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, inf, sin
from statistics import mean

from wire import Talk

WINDOW = 255  # bytes sent and not yet answered, as [OPT:…] allows
SETTINGS = (
    *("$0=3", "$1=255", "$10=3", "$100=250", "$101=250", "$102=250"),
    *("$110=30000", "$111=30000", "$112=30000", "$120=5000", "$121=5000", "$122=5000"),
)

_MOST_SKIPPED = 500
_MOVE_MM = 0.05


def short_moves(count: int, lines_s: float = 3000) -> "Iterator[str]":
    """Yield lines of 22 characters, moves of 0.05 mm, whose feed asks for lines_s lines a second.

    They go round a circle of 20 mm radius, so no corner slows the machine down.
    """
    for k in range(1, count + 1):
        angle = _MOVE_MM * k / 20
        x, y = 30 - 20 * cos(angle), 10 + 20 * sin(angle)
        yield f"G1X{x:06.3f}Y{y:06.3f}F{lines_s * _MOVE_MM * 60:.0f}"


def in_all_axes(letters: str, count: int, lines_s: float) -> "Iterator[str]":
    """Yield such moves with a word for every axis; axes after the second move slowly."""
    for k in range(1, count + 1):
        angle = _MOVE_MM * k / 20
        places = [30 - 20 * cos(angle), 10 + 20 * sin(angle)]
        places += [10 + 5 * sin(angle + i) for i in range(2, len(letters))]
        words = "".join(f"{letter}{at:06.3f}" for letter, at in zip(letters, places, strict=True))
        yield f"G1{words}F{1.15 * lines_s * _MOVE_MM * 60:.0f}"


def new_feeds(count: int) -> "Iterator[str]":
    """Yield short moves, each with a feed rate different from the one before."""
    for k, line in enumerate(short_moves(count)):
        yield f"{line[:-4]}{9000 - k % 2}"


def raster(count: int) -> "Iterator[str]":
    """Yield lines of a laser image: 0.1 mm per dot."""
    for k in range(count):
        yield f"G1X{10 + 0.1 * (k + 1):.1f}S{100 + 37 * (k % 9)}"


CLUSTER = 16  # dots in a line
CLUSTERS = ("$30=1000", "$32=1", "$110=30000", "$120=5000")


def clusters(count: int) -> "Iterator[str]":
    """Yield lines of a laser image: 16 dots of 0.01 mm in one line of text."""
    for k in range(count):
        powers = ":".join(str(100 + 53 * (k + i) % 900) for i in range(CLUSTER))
        yield f"X0.16S{powers}"


def arcs(count: int) -> "Iterator[str]":
    """Yield half circles of 1 mm radius, twelve chords or more each."""
    for k in range(count):
        yield f"G2X{12 + 2 * k}Y10I1J0F9000"


# A circle of 5 mm takes CIRCLE_CHORDS chords with this tolerance. The machine follows them faster
# than they can be planned with this acceleration.
CIRCLE = ("$12=0.00005", "$120=50000", "$121=50000")
CIRCLE_CHORDS = 702


def circles(count: int) -> "list[str]":
    """Return circles of 5 mm radius; with the settings CIRCLE each has CIRCLE_CHORDS chords."""
    return ["G2X10Y10I5J0F30000"] * count


def comments(count: int) -> "Iterator[str]":
    """Yield comments of 22 characters, line end included: they show the fixed cost of a line."""
    return (f"({k:05}: say nothing.)" for k in range(count))


@dataclass
class Streamed:
    """Figures of a stream.

    first_us, query_us: from `?` to the first and to the last byte of its answer; waiting: blocks
    in the planner when `?` was answered, the smallest number.
    """

    lines_s: float
    first_us: "list[float]"
    query_us: "list[float]"
    waiting: int


def stream(
    talk: Talk,
    lines: "list[str]",
    blocks: int,
    query_every_us: float = 0,
    window: int = WINDOW,
    limit_us: float = inf,
) -> Streamed:
    """Send lines by character counting; the lines that fill the planner are not counted.

    It ends when all lines are answered, or limit_us after the first counted one.
    """
    wire = talk.wire
    under_way: deque[int] = deque()
    answered = sent = 0
    begun_us = ended_us = wire.now_us()
    query_at_us = first_at_us = 0.0
    next_query_us = wire.now_us() + query_every_us
    answer_us: list[float] = []
    first_byte_us: list[float] = []
    waiting = blocks
    skip = min(len(lines) // 10 + blocks, len(lines) // 2, _MOST_SKIPPED)
    wire.received.clear()
    while answered < len(lines) and (answered <= skip or wire.now_us() < begun_us + limit_us):
        while sent < len(lines) and sum(under_way) + len(lines[sent]) + 1 <= window:
            wire.send(lines[sent].encode() + b"\n")
            under_way.append(len(lines[sent]) + 1)
            sent += 1
        if query_every_us and not query_at_us and wire.now_us() >= next_query_us:
            wire.send(b"?")
            query_at_us = wire.now_us()
        wire.turn()
        if query_at_us and not first_at_us and b"<" in wire.received:
            first_at_us = wire.now_us()
        while b"\n" in wire.received:
            line, _, rest = bytes(wire.received).partition(b"\n")
            wire.received[:] = rest
            if line.startswith(b"<"):
                answer_us.append(wire.now_us() - query_at_us)
                first_byte_us.append(first_at_us - query_at_us)
                query_at_us = first_at_us = 0.0
                next_query_us = wire.now_us() + query_every_us
                if skip < answered and sent < len(lines) and b"|Bf:" in line:
                    free = int(line.partition(b"|Bf:")[2].partition(b",")[0])
                    waiting = min(waiting, blocks - free)
            elif line.startswith(b"ok"):
                answered += 1
                under_way.popleft()
                if answered == skip:
                    begun_us = wire.now_us()
                ended_us = wire.now_us()
            elif line.strip():
                raise RuntimeError(f"line {answered + 1}: {line!r}")
    lines_s = (answered - skip) / (ended_us - begun_us) * 1e6
    return Streamed(lines_s, first_byte_us, answer_us, waiting)


def query_idle_us(talk: Talk, times: int = 20) -> "tuple[list[float], list[float]]":
    """Return the times from `?` to the first and to the last byte of the report, while idle."""
    first_us, whole_us = [], []
    for k in range(times):
        talk.pause_us(3_000 + 370 * k)
        talk.wire.received.clear()
        sent_us = talk.wire.now_us()
        talk.wire.send(b"?")
        first_us.append(talk.wait(b"<") - sent_us)
        whole_us.append(talk.wait(b">\r\n") - sent_us)
    return first_us, whole_us


def idle(talk: Talk) -> None:
    """Wait until the machine is idle."""
    while True:
        talk.wire.received.clear()
        talk.wire.send(b"?")
        talk.wait(b">\r\n")
        if b"<Idle" in talk.wire.received:
            return
        talk.pause_us(20_000)


def figures(values: "list[float]") -> "tuple[float, float]":
    """Return mean and worst, in ms."""
    return mean(values) / 1000, max(values) / 1000
