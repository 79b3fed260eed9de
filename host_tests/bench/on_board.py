"""What the benchmark runs on the board: its own commands, in MAIN, in front of the firmware's.

A board that is emulated has it for its main.py; a real one is given it at its prompt (prompt.py)
and keeps nothing of it. Objects of the firmware are got hold of as they pass by in a method, and
only names of modules, classes, functions and methods are used: `ugrbl build` keeps those.

`$STAGE` times the stages of a line, each in a loop with ticks_us, less the same loop with a
function that does nothing; a figure is in 0.1 us. The short path is one call that does several
stages, so it is called with what it knows (the arrays of the machine itself) changed in such a way
that it goes so far and no further: nothing is known (what a call costs, which is taken off); a
feed rate other than the line's (it has read the words); travel limited to nowhere (it has put the
place in and judged it); nothing is to move (all but planning); and as it is. Planning
fills the ring with 12 short moves, three times over. A line that goes the long way,
"G90G1X10.04Y10.03F9000T1", is taken apart into its words and put in the Block, checked, and
executed whole, less the two before. The machine is in check mode meanwhile, and reset afterwards.
"""

from control import canon, modes
from language import fast_kernel
from ugrbl.device.selftest import program

_FIRST = """
from boot import power_up  # first, as in main.py: it sees to where memory is free
"""
# As in main.py, in a class: what a collection of garbage takes depends on it.
_START = """
parts = power_up.build()


class Running:
    modules = power_up.modules
    machine = power_up.live(parts)
"""

# Commands: `$NAME=number` answers with numbers in a message, if there are any.
_COMMANDS = """
import gc
import time

commands = module("talk", "commands")
planner = module("motion", "planner")
report = module("talk", "report")
found = {}
acts = {}
usual = commands.Commands.whose


def keep(kind, name):
    usual = getattr(kind, name)

    def kept(self, *rest):
        found[kind] = self
        return usual(self, *rest)

    setattr(kind, name, kept)


def whose(self, line, length):
    name, _, value = bytes(line[1:length]).partition(b"=")
    act = acts.get(name)
    if act:
        numbers = act(int(value or b"0"))
        if numbers:
            found[report.Report].message(" ".join([str(x) for x in numbers]) + ".")
    else:
        return usual(self, line, length)
    return lambda line, length: None


def since(start):
    return time.ticks_diff(time.ticks_us(), start)


keep(report.Report, "banner")
keep(planner.Planner, "configure")
commands.Commands.whose = whose
"""

# $FREE; $COLLECT=n: mean and longest of n collections, us; $ALLOC: bytes on the heap; $GC=0 or 1:
# collections off or on; $COUNT=us: turns of a loop; $LATER=us: the same once a block is through.
_COUNTS = """
def collect(times):
    took = []
    for _ in range(times):
        start = time.ticks_us()
        gc.collect()
        took.append(since(start))
    return sum(took) // times, max(took)


def switch(on):
    (gc.enable if on else gc.disable)()
    return (on,)


def count(us):
    turns = 0
    start = time.ticks_us()
    while since(start) < us:
        turns += 1
    return (turns,)


def later(us):
    ring = found[planner.Planner]
    free = ring.free()
    start = time.ticks_us()
    while ring.free() <= free and since(start) < 300000:
        pass
    return count(us)


acts[b"FREE"] = lambda _: (gc.mem_free(),)
acts[b"COLLECT"] = collect
acts[b"ALLOC"] = lambda _: (gc.mem_alloc(),)
acts[b"GC"] = switch
acts[b"COUNT"] = count
acts[b"LATER"] = later
"""

# $STAGE: see above.
_STAGES = """
import array

interpreter = module("language", "interpreter")
lines = module("talk", "lines")
fast_kernel = module("language", "fast_kernel")
fast_path = module("language", "fast_path")
protocol = module("talk", "protocol")
keep(interpreter.Interpreter, "execute")
keep(fast_path.FastPath, "memory")
keep(protocol.Protocol, "run")
AXES, SHUT, DRY, MODAL_ROOM = %d, %d, %d, %d
follow = fast_kernel.follow_line

# A board lets go of what has made its objects; here one is made once more.
whole = [(thing, dict(thing.__dict__)) for thing in (lines, lines.LineReader)]


def restore():
    for thing, members in whole:
        for name, value in members.items():
            if getattr(thing, name, value) is None:
                setattr(thing, name, value)


def nothing(*_):
    return 0


def nothing_0():
    return 0


def each(act, texts, rest):
    found[protocol.Protocol].pump()  # the supervisor is not to take it for a hang
    gc.collect()
    start = time.ticks_us()
    for text in texts:
        act(text, 21, rest)
    return since(start) * 10 // len(texts)


def again(act, *rest):
    found[protocol.Protocol].pump()
    gc.collect()
    start = time.ticks_us()
    for _ in range(24):
        act(*rest)
    return since(start) * 10 // 24


def moves(k):
    places = [(10 + 0.04 * (k + i), 10 + 0.03 * (k + i)) for i in range(12)]
    return [bytearray(("G1X%%06.3fY%%06.3fF9000\\0" %% place).encode()) for place in places]


def expect(value, texts, rest):
    if follow(texts[0], 21, rest) != value:
        raise ValueError("a stage of follow()")


def short_path():
    rest = found[fast_path.FastPath].memory()
    now = rest[0]
    texts = moves(0)
    now[AXES] = 0
    call = each(follow, texts, rest)
    travel, dry = rest[3], now[DRY]
    shut = travel[SHUT]
    now[AXES] = 1  # it has read the line when it finds that there is no Y
    expect(0, texts, rest)
    read = each(follow, texts, rest)
    now[AXES] = len(rest[1])
    travel[SHUT] = -1
    expect(0, texts, rest)
    judged = each(follow, texts, rest)
    travel[SHUT] = shut
    now[DRY] = 1
    expect(1, texts, rest)
    moved = each(follow, texts, rest)
    now[DRY] = 0
    whole = 0
    for k in range(3):
        found[planner.Planner].clear()
        whole += each(follow, moves(12 * k + 1), rest)
    found[planner.Planner].clear()
    now[DRY] = dry
    now[AXES] = 0
    return read - call, judged - read, moved - judged, whole // 3 - moved


def long_way():
    line = bytearray(b"G90G1X10.04Y10.03F9000T1\\0")
    modal = array.array("i", (0 for _ in range(MODAL_ROOM)))
    machine = found[interpreter.Interpreter]

    def take():
        machine.block.read(line, 0, 24, modal)

    def check():
        take()
        machine.check(modal)

    idle = again(nothing_0)
    taken = again(take) - idle
    checked = again(check) - idle
    whole = again(machine.execute, line, 24) - again(nothing, line, 24)
    return taken, checked - taken, whole - checked


def clean(line):
    reader = lines.LineReader(255, 79, nothing)
    reader.feed(bytearray(line * 11), 11 * len(line))
    ring, at, text, kinds = reader.memory()
    go_on = lines.clean
    start = time.ticks_us()
    for _ in range(11):
        go_on(ring, at, text, kinds)
    took = since(start)
    start = time.ticks_us()
    for _ in range(11):
        nothing_0()
    return (took - since(start)) * 10 // 11


def stages(_):
    restore()
    comment = clean(b"(Twenty characters..)\\n")
    return short_path() + long_way() + (clean(b"G1X10.040Y10.030F9000\\n"), comment)


acts[b"STAGE"] = stages
""" % (fast_kernel.AXES, canon.SHUT, fast_kernel.DRY, modes.MODAL_ROOM)

# $GAP: the longest time from one look at the link to the next since it was asked last, us; no
# collection falls in where less than the heap is used until then, but for $COLLECT.
_GAPS = """
import board

gaps = [0, 0]


def watched(look):
    def look_and_note(*arguments):
        now = time.ticks_us()
        gap = time.ticks_diff(now, gaps[0])
        if gap > gaps[1]:
            gaps[1] = gap
        gaps[0] = now
        return look(*arguments)

    return look_and_note


def longest(_):
    gap = gaps[1]
    gc.collect()
    gaps[:] = time.ticks_us(), 0
    return (gap,)


kind = getattr(board, "LINK", "usb")
link = getattr(module("ports", kind + "_link"), {"usb": "UsbLink", "uart": "UartLink"}[kind])
if kind == "usb":
    make = link._make_read_into
    link._make_read_into = lambda self: watched(make(self))
else:
    link.read_into = watched(link.read_into)
acts[b"GAP"] = longest
acts[b"COLLECT"] = lambda _: gc.collect()  # which has no answer
"""

_BEGIN = program.found() + _FIRST + _COMMANDS
PLAIN = (program.found() + _FIRST + _START).encode()  # none of our commands
MAIN = (_BEGIN + _COUNTS + _START).encode()
STAGES = (_BEGIN + _STAGES + _START).encode()
GAPS = (_BEGIN + _GAPS + _START).encode()
