"""Define what the benchmark runs on the board: MAIN adds commands to the firmware.

An emulated board has this text as its main.py. A real board gets it at its prompt (prompt.py) and
stores nothing of it. Methods of the firmware are wrapped, which gives access to its objects when
they are called.

`$STAGE` times the stages of a line. Each stage runs in a loop timed by ticks_us; the time of the
same loop with an empty function is subtracted. Figures are in units of 0.1 us: reading and
checking the words; the remaining work without planning; planning. Planning fills the ring with 12
short moves, three times. A line with more words is also read and checked:
"G90G1X10.04Y10.03F9000T1". The machine is in check mode during this, and is reset afterwards.
"""

from base.state import CHECK

_FIRST = """
from boot import power_up  # first, as in main.py: it sees to where memory is free
"""
_START = """
machine = power_up.run_machine(power_up.build())
"""

# Our commands: `$NAME=number` answers with a message of numbers, if it has any.
_COMMANDS = """
import gc
import time

from talk import commands
from motion import planner
from talk import report
found = {}
acts = {}
usual = commands.Commands.find_command


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
commands.Commands.find_command = whose
"""

# $FREE: free bytes; $COLLECT=n: mean and longest of n collections, us; $ALLOC: bytes on the heap;
# $GC=0 or 1: collections off or on; $COUNT=us: turns of a loop in this time; $LATER=us: the same
# after a block has finished; $HOLE: the largest hole of the heap, bytes.
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


def hole(_):
    gc.collect()
    low, high = 1000, 100000
    while high - low > 1000:  # in time for the supervisor
        size = (low + high) // 2
        try:
            bytearray(size)
            low = size
        except MemoryError:
            high = size
    return (low,)


acts[b"HOLE"] = hole
acts[b"FREE"] = lambda _: (gc.mem_free(),)
acts[b"COLLECT"] = collect
acts[b"ALLOC"] = lambda _: (gc.mem_alloc(),)
acts[b"GC"] = switch
acts[b"COUNT"] = count
acts[b"LATER"] = later
"""

# $STAGE: see the module's docstring.
_STAGES = (
    """
from language import interpreter
from language import line
from talk import lines
from talk import protocol
keep(interpreter.Interpreter, "memory")
keep(protocol.Protocol, "run")
look, go = line.check_line, line.run_move
CHECK = %d

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


def each(act, texts, *rest):
    found[protocol.Protocol].pump()  # the supervisor is not to take it for a hang
    gc.collect()
    start = time.ticks_us()
    for text in texts:
        act(text, *rest)
    return since(start) * 10 // len(texts)


def moves(k):
    places = [(10 + 0.04 * (k + i), 10 + 0.03 * (k + i)) for i in range(12)]
    return [bytearray(("G1X%%06.3fY%%06.3fF9000\\0" %% place).encode()) for place in places]


def fill(modal, memory):
    took = 0
    for text in moves(1):
        asked = look(text, 21 << 8, modal, 0, memory)
        start = time.ticks_us()
        go(asked, modal, memory)
        took += since(start)
    return took * 10 // 12


def of_a_line():
    modal, _, memory = found[interpreter.Interpreter].memory()
    running = found[interpreter.Interpreter]._state.running
    texts = moves(0)
    call = each(nothing, texts, 21 << 8, modal, 0, memory)
    looked = each(look, texts, 21 << 8, modal, 0, memory) - call
    more = [bytearray(b"G90G1X10.04Y10.03F9000T1\\0")] * 12
    more = each(look, more, 24 << 8, modal, 0, memory) - call
    running[0] = CHECK
    found[planner.Planner].clear()
    done = fill(modal, memory)
    running[0] = 0
    whole = 0
    for k in range(3):
        found[planner.Planner].clear()
        whole += fill(modal, memory)
    found[planner.Planner].clear()
    running[0] = CHECK
    return looked, done, whole // 3 - done, more


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
    return of_a_line() + (clean(b"G1X10.040Y10.030F9000\\n"), comment)


acts[b"STAGE"] = stages
"""
    % CHECK
)

# $GAP: longest time between two reads of the link since the last $GAP, us. $GAP and $COLLECT
# collect garbage, so no other collection runs until the heap is used up.
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
if kind == "usb":
    from ports.usb.usb_link import UsbLink as link

    make = link._make_read_into
    link._make_read_into = lambda self: watched(make(self))
else:
    from ports.uart_link import UartLink as link

    link.read_into = watched(link.read_into)
acts[b"GAP"] = longest
acts[b"COLLECT"] = lambda _: gc.collect()  # which has no answer
"""

_BEGIN = _FIRST + _COMMANDS
PLAIN = (_FIRST + _START).encode()  # without our commands
MAIN = (_BEGIN + _COUNTS + _START).encode()
STAGES = (_BEGIN + _STAGES + _START).encode()
GAPS = (_BEGIN + _GAPS + _START).encode()
