"""Measure rows as a sender, and with our own commands on the board."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import prompt
import streaming
from bench_setup import Bench, inside, reset, set_up
from emulated import files_of, firmware, for_this_chip
from on_board import GAPS, MAIN, PLAIN, STAGES
from rows import Row
from streaming import (
    CIRCLE,
    CIRCLE_CHORDS,
    CLUSTER,
    CLUSTERS,
    SETTINGS,
    Streamed,
    arcs,
    circles,
    comments,
    figures,
    idle,
    in_all_axes,
    new_feeds,
    query_idle_us,
    raster,
    short_moves,
    stream,
)
from ugrbl.compiling import build
from ugrbl.paths import BOARDS
from ugrbl.sim import motor_names
from wire import EmulatedWire, Talk

_ASKED = 700  # short moves per second
_TOO_MUCH = 2400  # the same; the firmware is the limit
_BLOCKS = 63
# About 40 ms, but no whole number of lines: reports shall fall on any phase of a line.
_QUERY_US = 39_700


def _boards_of_axes() -> "Iterator[tuple[str, tuple[int, str]]]":
    pico = (BOARDS / "rpi_pico.py").read_text("utf-8")
    yield "three axes", (3, pico)
    yield "three axes and a skew", (3, f"{pico}\nSKEW = True\n")
    gantry = (BOARDS / "pico_gantry.py").read_text("utf-8")
    yield "three axes, two motors on Y", (3, gantry)
    six = (BOARDS / "pico_six.py").read_text("utf-8")
    for count, word in ((4, "four"), (5, "five"), (6, "six")):
        cut = ", ".join(f"{name}[:{count}]" for name in ("STEP", "DIR", "LIMIT"))
        yield f"{word} axes", (count, f"{six}\nSTEP, DIR, LIMIT = {cut}\n")


# Number of axes, and the text of the board file.
OF_AXES = dict(_boards_of_axes())


def _at_start(talk: Talk) -> None:
    for line in ("G90", "G94", "G0X10Y10"):
        talk.ask(line)
    idle(talk)


def boot(bench: Bench) -> Iterator[Row]:
    """Time power-up to the welcome's last byte; read free memory at the prompt after Ctrl-C."""
    first = bench.board().boot(until="for help]\r\n")
    yield Row("power-up to welcome, first start", first.pico.us / 1000, "ms", "first start")
    first.settled()
    board = bench.board()
    board.pico.put_file_system(first.pico.flash_image())
    board.boot(until="for help]\r\n")
    yield Row("power-up to welcome, settings kept", board.pico.us / 1000, "ms", "start")
    board.ask("")
    talk = Talk(EmulatedWire(board))
    prompt.leave_firmware(talk)
    free = prompt.run(talk, "import gc\ngc.collect()\nprint(gc.mem_free())")
    yield Row("memory free, nothing but the firmware", int(free) / 1000, "kB")


def memory(bench: Bench) -> Iterator[Row]:
    """Measure the heap while the machine runs, with the benchmark's commands loaded.

    The first collection removes the garbage of the lines before it; the others find none.
    """
    talk = bench.talk(MAIN)
    _at_start(talk)
    stream(talk, [f"G1G90X{10 + k % 9}F9000" for k in range(12)], _BLOCKS)
    idle(talk)
    mean, longest = inside(talk, "$COLLECT=6")
    yield Row("a collection, mean", mean / 1000, "ms")
    yield Row("a collection, longest", longest / 1000, "ms")
    (free,) = inside(talk, "$FREE")
    yield Row("memory free with the benchmark's commands", free / 1000, "kB")


def heap(bench: Bench) -> Iterator[Row]:
    """Measure the bytes that a line leaves on the heap, with collections off.

    A longer and a shorter stream of the same kind are compared, so the cost of start and end
    cancels, except for some blocks of 16 bytes. A difference below 0 is shown as 0.
    """
    talk = bench.talk(MAIN)
    talk.ask("$32=1")
    kinds = {
        "G1 X Y": (list(short_moves(48)), "M5"),
        "G1 X S in M4": (list(raster(48)), "M4S0"),
        "half circle of 1 mm": (list(arcs(6)), "M5"),
        "a tool, moves, a half circle": (["T1G1X12", "G1X11", "G1X12", "G3X10I-1J0"] * 3, "M5"),
    }
    for name, (sent, spindle) in kinds.items():
        for line in (spindle, "G90G1X10Y10F4000"):
            talk.ask(line)
        third_of_lines = len(sent) // 3
        fewer = _left(talk, sent[:third_of_lines])
        more = _left(talk, sent[third_of_lines:])
        left = (more - fewer) / (len(sent) - 2 * third_of_lines)
        yield Row(f"heap per line, {name}", max(left, 0), "bytes")
    idle(talk)
    talk.ask("M5")
    talk.ask("$32=0")


def _left(talk: Talk, sent: "list[str]") -> int:
    """Return the bytes that these lines leave, with those of starting and ending the stream."""
    idle(talk)
    inside(talk, "$COLLECT=1")
    inside(talk, "$GC=0")
    (before,) = inside(talk, "$ALLOC")
    stream(talk, sent, _BLOCKS)
    (after,) = inside(talk, "$ALLOC")
    inside(talk, "$GC=1")
    return after - before


def settings(bench: Bench) -> Iterator[Row]:
    """Measure what storing settings leaves: bytes of garbage, and the largest hole of the heap."""
    talk = bench.talk(MAIN)
    yield Row("largest hole of the heap", inside(talk, "$HOLE")[0] / 1000, "kB")
    inside(talk, "$COLLECT=1")
    inside(talk, "$GC=0")
    (before,) = inside(talk, "$ALLOC")
    talk.ask("$110=900")
    (after,) = inside(talk, "$ALLOC")
    inside(talk, "$GC=1")
    yield Row("garbage of a setting", after - before, "bytes")
    for k in range(12):
        talk.ask(f"${(110, 120)[k % 2] + k % 3}={1000 + k}")
    for line in ("$11=0.02", "$12=0.003", "$27=2", "$25=600", "$24=30", "$30=900"):
        talk.ask(line)
    yield Row("largest hole after 18 settings", inside(talk, "$HOLE")[0] / 1000, "kB")
    for line in ("$11=0.01", "$12=0.002", "$27=1", "$25=500", "$24=25", "$30=1000"):
        talk.ask(line)
    set_up(talk)


def queries(bench: Bench) -> Iterator[Row]:
    """Time status reports while idle: from `?` to the first and to the last byte of the answer."""
    talk = bench.talk(MAIN)
    first, whole = query_idle_us(talk, 8)
    yield Row("? at rest, to the first byte, mean", figures(first)[0], "ms", "asked at rest")
    yield Row("? at rest, whole answer, mean", figures(whole)[0], "ms")
    yield Row("? at rest, whole answer, worst", figures(whole)[1], "ms")


def lines(bench: Bench) -> Iterator[Row]:
    """Time streams of short moves, sent by character counting."""
    talk = bench.talk(MAIN)
    _at_start(talk)
    streamed = stream(talk, list(short_moves(1000, _ASKED)), _BLOCKS, query_every_us=_QUERY_US)
    name = f"short moves, {_ASKED} asked, ? every 40 ms"
    yield Row(name, streamed.lines_s, "lines/s", "streamed")
    yield Row("least blocks in the planner then", streamed.waiting)
    yield from _queried(streamed)
    _at_start(talk)
    streamed = stream(talk, list(short_moves(250, _TOO_MUCH)), _BLOCKS)
    yield Row(f"short moves, {_TOO_MUCH} asked", streamed.lines_s, "lines/s", "streamed")
    idle(talk)
    talk.ask("$C")
    streamed = stream(talk, list(short_moves(250)), _BLOCKS)
    yield Row("short moves, check mode", streamed.lines_s, "lines/s", "checked")
    _leave_check(talk)


_FIT = 60  # moves that fit in the planner without waiting
_OTHER_PLANES = ("G18G1X10.04Y10.03", "G17G1X10Y10")
_LONG = (
    ("a tool and a move", ["T1G1X10.04Y10.03F9000", "T2G1X10Y10F9000"]),
    ("a tool", ["T1", "T2"]),
    (
        "modes that change and a move",
        [f"{modes}F9000" for modes in ("G91G1X0.04Y0.03", "G90G1X10Y10", *_OTHER_PLANES)],
    ),
    ("modes that change", ["G91G20", "G18", "G90G21", "G17"]),
    ("a time (G93) and a move", ["G93G1X10.04Y10.03F90000", "G93G1X10Y10F99000"]),
    ("words in force and a move", ["G90G1X10.04Y10.03F9000", "G90G1X10Y10F9000"]),
    ("words in force", ["G17G21G90G94", "M5M9"]),
    ("an arc of one chord", ["G2X10.04Y10R9F9000", "G3X10Y10R9"]),
)
_TWO_CHORDS = ("an arc of two chords", ["G2X10.8Y10R9F9000", "G3X10Y10R9"])
_ASKED_FOR = ("$J=G91X0.01F3000", "$G", "$#", "$$")


def long_lines(bench: Bench) -> Iterator[Row]:
    """Time lines with modes: ms for each in a stream.

    Also: the time until the answer to a line that asks for something is complete.
    """
    talk = bench.talk(MAIN)
    for name, lines in (*_LONG, _TWO_CHORDS):
        _at_start(talk)
        moves = _FIT // 2 if lines is _TWO_CHORDS[1] else _FIT
        streamed = stream(talk, lines * (moves // len(lines)), _BLOCKS)
        yield Row(f"a line with {name}", 1000 / streamed.lines_s, "ms a line")
        idle(talk)
    talk = bench.talk(PLAIN)  # our commands read every line that begins with $
    for line in _ASKED_FOR:
        times_us = []
        for _ in range(5):
            idle(talk)
            talk.wire.received.clear()
            sent_us = talk.wire.now_us()
            talk.wire.send(line.encode() + b"\n")
            times_us.append(talk.wait(b"ok\r\n") - sent_us)
        yield Row(f"{line} to the end of its answer, mean", figures(times_us)[0], "ms")
    _at_start(talk)


def _leave_check(talk: Talk) -> None:
    talk.wire.send(b"$C\n")
    talk.wait(b"Grbl")
    talk.pause_us(20_000)


def _queried(streamed: Streamed) -> Iterator[Row]:
    """Yield the times of status reports in a stream."""
    first, whole = figures(streamed.first_us), figures(streamed.query_us)
    yield Row("? while streaming, to the first byte, mean", first[0], "ms", "asked")
    yield Row("? while streaming, to the first byte, worst", first[1], "ms")
    yield Row("? while streaming, whole answer, mean", whole[0], "ms")
    yield Row("? while streaming, whole answer, worst", whole[1], "ms")


def special_lines(bench: Bench) -> Iterator[Row]:
    """Time a laser's raster, moves with a new feed rate each, and arcs."""
    talk = bench.talk(MAIN)
    for line in ("$32=1", "$120=20000", "M4S0", "G90G1X10Y10F15000"):  # reaches 2500 dots/s
        talk.ask(line)
    idle(talk)
    streamed = stream(talk, list(raster(300)), _BLOCKS)
    yield Row("raster, G1 X S in M4", streamed.lines_s, "lines/s")
    idle(talk)
    talk.ask("$120=5000")
    _at_start(talk)
    streamed = stream(talk, list(new_feeds(300)), _BLOCKS)
    yield Row("short moves, a new F each", streamed.lines_s, "lines/s")
    _at_start(talk)
    streamed = stream(talk, list(arcs(24)), _BLOCKS)
    yield Row("half circles of 1 mm", streamed.lines_s, "lines/s")
    idle(talk)
    talk.ask("M5")
    talk.ask("$32=0")


def clusters(bench: Bench) -> Iterator[Row]:
    """Time a laser's dots, 16 in a line, on an emulated board of its own that supports them."""
    if not bench.emulated:
        return
    talk = Talk(EmulatedWire(bench.board(files_of("pico_laser")).boot().settled()))
    for line in (*SETTINGS, *CLUSTERS, "G91G1F9000M4S0"):
        talk.ask(line)
    streamed = stream(talk, list(streaming.clusters(150)), _BLOCKS)
    yield Row("clusters of 16 dots, M4", streamed.lines_s, "lines/s")
    yield Row("dots of clusters, M4", streamed.lines_s * CLUSTER, "dots/s")


def axes(bench: Bench) -> Iterator[Row]:
    """Time short moves in all axes, and read free memory, on emulated boards of their own.

    Boards of three axes are as the default board; one has a skew, and one is pico_gantry.py.
    Boards of more axes have the first motors of pico_six.py.
    """
    if not bench.emulated:
        return
    for name in OF_AXES:
        yield from of_axes(bench, name)


def of_axes(bench: Bench, name: str) -> Iterator[Row]:
    """Yield the rows of one of these boards, emulated."""
    count, text = OF_AXES[name]
    letters = motor_names.AXIS_LETTERS[:count]
    with TemporaryDirectory() as folder:
        file = Path(folder, "axes.py")
        file.write_text(text, "utf-8")
        build_files = build.for_board(for_this_chip(file)).files
    board = bench.board({**dict.fromkeys(firmware()), **build_files, "main.py": MAIN})
    for pin in (*range(9, 16), *range(15, 23), 0, 1, 28):
        board.pico.drive(pin, 1)
    talk = Talk(EmulatedWire(board.boot().settled()))
    numbers = ((100, 250), (110, 30_000), (120, 5000))
    of_all = [f"${n + axis}={value}" for n, value in numbers for axis in range(count)]
    skew = ["$780=1", "$781=-1", "$782=1"] if "SKEW" in text else []
    for line in ("$0=3", "$1=255", "$10=3", *of_all, *skew, "G90"):
        talk.ask(line)
    talk.ask("G0" + "".join(f"{letter}10" for letter in letters))
    idle(talk)
    streamed = stream(talk, list(in_all_axes(letters, 250, _TOO_MUCH)), _BLOCKS)
    yield Row(f"short moves of {name}", streamed.lines_s, "lines/s", "streamed")
    idle(talk)
    inside(talk, "$COLLECT=2")
    (free,) = inside(talk, "$FREE")
    yield Row(f"memory free with {name}", free / 1000, "kB")


def chords(bench: Bench) -> Iterator[Row]:
    """Time circles of many chords, which only the firmware limits, and arcs in check mode."""
    talk = bench.talk(MAIN)
    for line in CIRCLE:
        talk.ask(line)
    _at_start(talk)
    streamed = stream(talk, circles(3), _BLOCKS)
    yield Row("chords of circles", streamed.lines_s * CIRCLE_CHORDS, "chords/s")
    idle(talk)
    talk.ask("$C")
    streamed = stream(talk, list(arcs(150)), _BLOCKS)
    yield Row("half circles, check mode", streamed.lines_s, "lines/s")
    _leave_check(talk)
    talk.ask("$12=0.002")
    set_up(talk)


def stages(bench: Bench) -> Iterator[Row]:
    """Time the stages of a line in us (see on_board.py).

    Receive and answer is USB, the link, the ring and the loop: the time of a comment from end to
    end, less its cleaning. Compare the sum without planning with a line in check mode.
    """
    talk = bench.talk(STAGES)
    total_us = 1e6 / stream(talk, list(comments(150)), _BLOCKS).lines_s
    idle(talk)
    talk.ask("$C")
    checked_us = 1e6 / stream(talk, list(short_moves(150)), _BLOCKS).lines_s
    looked, done, plan, more, clean, comment = (x / 10 for x in inside(talk, "$STAGE"))
    reset(talk)
    yield Row("a comment, from end to end", total_us, "us", "empty")
    stages = (total_us - comment, clean, looked, done, plan)
    names = ("receive and answer", "clean", "words and check", "execute", "plan")
    for name, us in zip(names, stages):
        yield Row(f"a line: {name}", us, "us")
    yield Row("a line: sum without plan", sum(stages[:-1]), "us")
    yield Row("a line in check mode, from end to end", checked_us, "us")
    yield Row("a line with G90 and T1 besides: words and check", more, "us")


def gaps(bench: Bench) -> Iterator[Row]:
    """Measure the longest time between two reads of the link while lines stream.

    Once without a collection, and once with a collection in the middle of arcs.
    """
    talk = bench.talk(GAPS)
    collecting = list(arcs(16))
    collecting.insert(8, "$COLLECT")
    for name, sent in (
        ("short moves", list(short_moves(120))),
        ("half circles", list(arcs(6))),
        ("half circles and a collection", collecting),
    ):
        _at_start(talk)
        inside(talk, "$GAP")
        stream(talk, sent, _BLOCKS, query_every_us=_QUERY_US)
        (longest,) = inside(talk, "$GAP")
        yield Row(f"longest gap between services, {name}", longest / 1000, "ms")
    idle(talk)
    set_up(talk)
