"""A machine that receives bytes that are not text, and one whose flash is damaged.

Runs under both Pythons: test_bytes.py and test_damaged_flash.py call it, and let MicroPython run
main(), which prints the number of lines tried.
"""

import os
import sys

try:
    from ugrbl.boardfile.files import load_board
    from ugrbl.sim.link import SimLink
    from ugrbl.sim.network import RigLink
    from ugrbl.sim.rig import Rig
    from ugrbl.sim.sender import Sender
except ImportError:  # MicroPython
    from sim.link import SimLink
    from sim.network import RigLink
    from sim.rig import Rig
    from sim.sender import Sender

    def load_board(name: str):
        return getattr(__import__("boards." + name), name)


from base import state as st
from ports.storage.flash_store import FlashStore
from vectors import Dice

_CUSTOM = """
from ugrbl import mcode, gcode
@mcode(100, "p")
def keep(m, P=0):
    m.keep["value"] = m.keep.get("value", 0) + P
    m.message("value %s" % m.keep["value"])
@mcode(101)
def fail(m):
    raise ValueError("as was asked for")
@mcode(102)
def run(m):
    m.run(FOLDER + "/run.nc")
@gcode(101)
def dwell(m):
    m.g("G4P0.001 (\\xe9)")
"""
_ALL = {"LENIENT": True, "JOBS": "jobs", "LINK": "wifi", "CUSTOM": "bytes_custom"}
# Boards: options in addition to sim's. They cover all extras that read a sender's text.
BOARDS = {
    "plain": {},
    "0.9": {"DIALECT": "0.9"},
    "hal": {"DIALECT": "hal", "JOBS": "jobs"},
    "echo": {"DIALECT": "0.9i", "ECHO": True},
    "all": dict(_ALL, DIALECT="0.9"),
    "all 1.1": dict(_ALL, COUNT_DRAINS=True, JERK=True),
    "laser": {"DIALECT": "0.9", "TOOL": "laser", "PWM_MAX": 1000, "CLUSTERS": True},
    "punch": {"DIALECT": "0.9"},
    "rotary": {"DIALECT": "0.9", "STEP": (0, 1, 2, 3), "ROTARY": "A", "LENIENT": True},
    "skew": {"DIALECT": "0.9", "SKEW": True, "LINE_NUMBERS": True},
    "drivers": {"DIALECT": "0.9", "TMC2209": (0, 2, 1), "TMC_UART": (8, 9)},
}
# Boards tried under MicroPython.
MICROPYTHONS = ("plain", "hal", "echo", "all", "punch")

# Text before the tested bytes.
_BEGINNINGS = (
    b"$ $$ $# $G $I $I= $I+ $N $N0= $N1=G4P0.0 $N0=G0 $C $X $H $S $SL $R $RST= $J $J= "
    b"$J=G91X0.1F90 $1 $1= $100=25 $x $130 $F $F= $F<= $FD= $FB= $FU= $FU=A.NC,4, $F=GOOD.NC "
    b"$F=GOOD.NC@ $F=@ $SD/ $SD/RUN= $LOCALFS/SHOW= $LOCALFS/LIST $NET $NET/ $NET/KEY= "
    b"$NET/SSID= $NET/PASS+ $NET/HOST= $NET/PORT= $NET/ALLOW= $NET/MODE= G G1X G91G0X0. "
    b"G38.2 G38.2Z G2X1I G4P0.0 G10L2P1X G10L20P0X G28 G28.1 G43.1Z G81X1Y1R1Z G83 G98 G92X "
    b"M M3S M6 M6T M100 M100P M101 M102 G101 T S F900 N N5 X O % G1X0.1S0: G1X0.1F100S1:2: ( "
    b"(MSG, ; / G0X0Y0( $E $ES $EA $+ $SPINDLESH $HELP $FM"
).split(b" ")
# The first and the last byte outside printable ASCII, a letter in UTF-8 and one in Latin-1, parts
# of letters.
_BYTES = (b"\x7f", b"\x80", b"\xff", b"\xc3\xa9", b"\xe9", b"\xe2\x82", b"\xf0\x9f")
_ENDS = (b"", b"1", b"=1", b"A.NC", b"\xb0C")
# Not sent within a line: they end the line or reset the machine.
_NOT_OF_A_LINE = b"\r\n\x18\x19"
_SLEEP = b"$SLP"


class Board:
    """A namespace with the board's options."""


def _board(name: str, folder: str) -> Board:
    made = Board()
    module = load_board("sim_punch_09" if name == "punch" else "sim")
    for key, value in dict(module.__dict__, **BOARDS[name]).items():
        if key[:2] != "__":
            setattr(made, key, value)
    if hasattr(made, "JOBS"):
        made.JOBS = folder + "/jobs"
    if not hasattr(made, "CUSTOM"):
        made.CUSTOM = ""
    return made


def write(path: str, data: bytes) -> None:
    with open(path, "wb") as file:
        file.write(data)


def read(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def _link(rig):
    return RigLink(rig, SimLink(rig), None)


class Bench:
    """A machine of one of BOARDS with its files in a folder. said: its output since power-up."""

    def __init__(self, name: str, folder: str) -> None:
        os.chdir(folder)
        if folder not in sys.path:
            sys.path.insert(0, folder)
        self.store = FlashStore(folder + "/flash/")
        link = _link if "LINK" in BOARDS[name] else SimLink
        self.rig = Rig(_board(name, folder), self.store, link)
        self.sender = Sender(self.rig)
        self.output = []

    def run(self, script) -> None:
        """Power up and run the script after the welcome. Raise the script's exception, if any."""
        ended = []

        def whole():
            self.sender.allow(3600_000)
            yield from self.sender.wait("banner", "", 100)
            self.output += self.sender.take()
            yield from script(self)
            ended.append(True)

        self.rig.run(whole())
        assert ended, "the machine has ended"

    def line(self, data: bytes):
        """Send a line and wait for its one answer. Resume a machine that the line has held; clear
        an
        alarm."""
        rig, sender = self.rig, self.sender
        state = rig.controller.state
        rig.link.send(data + b"\n")
        waited = 0
        while not sender.answers:
            waited += 1
            assert waited < 2000, ("no answer", data)
            yield rig.ms(3)
            sender.poll()
            if state.run & (st.HOLD | st.DOOR):
                rig.link.send(b"~")
        if data[:2] in (b"$C", b"$R"):
            yield rig.ms(700)  # a reset follows
            if state.run == st.CHECK:
                self.output += sender.take()
                yield from self.line(b"$C")
        if state.run == st.ALARM and data != b"$X":
            yield rig.ms(600)
            self.output += sender.take()
            yield from self.line(b"$X")
        assert sender.answers <= 1, (data, sender.lines)
        self.output += sender.take()

    def lines(self, *texts):
        for text in texts:
            yield from self.line(text)


def write_initial_files(folder: str) -> None:
    """Write the board's initial files."""
    for path in ("", "/flash", "/jobs"):
        os.mkdir(folder + path)
    write(folder + "/hal.txt", b"ES 0 [SETTING:0|35|Pulse]\r\nES 7 [SETTING:7|1|None]\r\n")
    write(folder + "/bytes_custom.py", ("FOLDER = %r\n" % folder + _CUSTOM).encode())
    every = bytes(byte for byte in range(256) if byte not in b"\r\n)")
    write(folder + "/run.nc", b"G4P0.001 (" + every + b")\r\n\tG4 P0.002\n")
    write(folder + "/jobs/GOOD.NC", b"(" + every + b")\nG91G0X0.1\n;" + every + b"\nG0X-0.1\n")
    for number, byte in enumerate((0x7F, 0x80, 0xE9, 0xFF)):
        write(folder + "/jobs/BAD%d.NC" % number, b"G91\nG0X0.%c1\nG0X-0.1\n" % byte)


# Bytes that are not text


def lines_of(dice, how_many):
    """Yield lines with such bytes: how_many for each beginning, or all if None."""
    any_byte = [bytes([b]) for b in range(256) if b not in _NOT_OF_A_LINE]
    for beginning in _BEGINNINGS:
        if how_many is None:
            middles, ends = list(_BYTES) + any_byte, _ENDS
        else:
            kinds = (_BYTES, any_byte)
            middles = [dice.any(kinds[turn % 2]) for turn in range(how_many)]
            ends = (dice.any(_ENDS),)
        for middle in middles:
            for end in ends:
                line = beginning + middle + end
                if line.upper() != _SLEEP:
                    yield line


def send_foreign_bytes(name: str, folder: str, seed: int, how_many) -> int:
    """Send such lines, and run jobs with such bytes. Return the number of lines."""
    bench = Bench(name, folder)
    count = [0]

    def script(bench):
        for line in lines_of(Dice(seed), how_many):
            yield from bench.line(line)
            count[0] += 1
        yield from bench.lines(b"M5", b"G4P0", b"$N0=G21")
        bench.rig.link.send(b"\x18")
        yield bench.rig.ms(1000)
        bench.output += bench.sender.take()  # with the output of the startup line
        yield from bench.lines(b"$X", b"G90", b"G0X0.5", b"G4P0", b"$I", b"$N", b"$#", b"$G")
        if "CUSTOM" in BOARDS[name]:
            begun = len(bench.output)
            yield from bench.lines(b"M100P1", b"M102", b"G101")
            assert bench.output[begun:].count("ok") == 3, bench.output[begun:]
        if name == "hal":
            yield from bench.line(b"$ES")
            assert "[SETTING:0|35|Pulse]" in bench.output, bench.output
            assert "[SETTING:7|1|None]" not in bench.output, "the machine has no $7"
        for job in ("GOOD", "BAD0", "BAD1", "BAD2", "BAD3"):
            if "JOBS" in BOARDS[name]:
                yield from bench.line(b"$F=%s.NC" % job.encode())
                yield bench.rig.ms(2000)
        bench.output += bench.sender.take()

    bench.run(script)
    said = bench.output
    assert not [line for line in said if line.startswith("ALARM:16")], said
    if "JOBS" in BOARDS[name]:
        assert [line for line in said if "Job GOOD.NC: done" in line], said[-20:]
        refused = len([line for line in said if "Job BAD" in line and "refused with 1" in line])
        takes_upper = BOARDS[name].get("DIALECT", "1.1")[:1] == "0"  # accepts bytes in lines
        assert refused == (4 if takes_upper else 1), said
    return count[0]


# Damaged flash

NAMES = ("settings", "coords", "startup", "build", "network", "keep", "job", "button", "custom")
_FROM_THE_START = NAMES[:6]  # read before the welcome
_SHOW = (b"$$", b"$#", b"$N", b"$I", b"M100", b"$FB", b"$I+")


def store_under_all_names(folder: str) -> None:
    """Let a machine store something under each of NAMES, twice."""
    write_initial_files(folder)
    long = b"\n".join([b"G1X%dF9000" % (5 + i % 2) for i in range(40)])
    write(folder + "/jobs/LONG.NC", long)
    write(folder + "/jobs/OTHER.NC", long)

    def script(bench):
        rig = bench.rig
        for turn in (b"1", b"2"):
            job = b"OTHER.NC" if turn == b"1" else b"LONG.NC"
            for text in (b"$100=25", b"G10L2P1X", b"$N1=G4P0.", b"$I=THE", b"$NET/PORT=2"):
                yield from bench.line(text + turn)
            yield from bench.lines(b"M100P" + turn, b"$FB=" + job, b"M101", b"$F=" + job)
            yield rig.ms(1000)
            rig.link.send(b"!")
            yield rig.ms(1000)
            rig.link.send(b"\x18")
            yield rig.ms(1000)
            bench.output += bench.sender.take()
            yield from bench.line(b"$X")

    Bench("all 1.1", folder).run(script)
    there = os.listdir(folder + "/flash")
    for name in NAMES:
        assert name + ".txt" in there and name + ".old" in there, (name, there)


def view(folder: str):
    """Return a machine's stored values without the secret network key, and all its output."""
    bench = Bench("all 1.1", folder)
    shown = []

    def script(bench):
        greeting, bench.output = bench.output, []
        yield from bench.lines(*_SHOW)
        shown.extend([line for line in bench.output if not line.startswith("[MSG:Custom")])
        shown.extend([line for line in greeting if "[MSG:Job" in line])
        shown.append(bench.rig.controller.saves.load("network") or [])
        bench.rig.link.send(b"\x18")  # reports damage that was found after the start
        yield bench.rig.ms(300)
        bench.output = greeting + bench.output + bench.sender.take()

    bench.run(script)
    port = [line for line in shown.pop() if not line.startswith("KEY=")]
    return shown + port, bench.output


def damages(data: bytes, dice, flips):
    """Yield damaged versions of a file: one bit flipped, truncated (each `flips` times, or
    everywhere if
    None), all 0xFF, empty, random bytes, and one byte appended."""
    bits = range(8 * len(data))
    for bit in bits if flips is None else [dice.any(bits) for _ in range(flips)]:
        spoilt = bytearray(data)
        spoilt[bit >> 3] ^= 1 << (bit & 7)
        yield bytes(spoilt)
    lengths = range(len(data))
    for length in lengths if flips is None else [dice.any(lengths) for _ in range(flips)]:
        yield data[:length]
    yield b"\xff" * len(data)
    yield b""
    yield bytes([dice.below(256) for _ in range(len(data))])
    yield data + b"\xff"


def _restore(folder: str, kept) -> None:
    for file in os.listdir(folder + "/flash"):
        os.remove(folder + "/flash/" + file)
    for file, data in kept.items():
        write(folder + "/flash/" + file, data)


def flash_files(folder: str):
    """Return the files of the machine's flash."""
    return {file: read(folder + "/flash/" + file) for file in os.listdir(folder + "/flash")}


def start_damaged(folder: str, kept, name: str, dice, flips: int) -> int:
    """Start a machine with each damage to one stored name; return the number of starts.

    All other values must be unchanged, this one must be the older copy or missing, and the machine
    must report it."""
    now, old = name + ".txt", name + ".old"
    _restore(folder, dict(kept, **{now: kept[old]}))
    before, _ = view(folder)
    without = {file: data for file, data in kept.items() if file not in (now, old)}
    _restore(folder, without)
    none, _ = view(folder)
    count = 0
    for spoilt in damages(kept[now], dice, flips):
        count += 1
        _restore(folder, dict(kept, **{now: spoilt}))
        _check_report(folder, name, before, "older copy")
    _restore(folder, dict(without, **{old: kept[old]}))
    _check_report(folder, name, before, "older copy")
    spoilt = b"\x80" + kept[now][1:]
    _restore(folder, dict(kept, **{now: spoilt, old: spoilt}))
    _check_report(folder, name, none, "lost")
    return count + 2


def _check_report(folder: str, name: str, wanted, how: str) -> None:
    shown, said = view(folder)
    assert shown == wanted, (name, shown, wanted)
    told = [line for line in said if line.startswith("[MSG:Damaged in flash")]
    assert set(told) == {"[MSG:Damaged in flash: %s (%s)]" % (name, how)}, (name, said)
    if name in _FROM_THE_START:  # at the same place as Grbl
        assert "error:7" in said[: said.index("Grbl 1.1h ['$' for help]")], (name, said)


def start_with_damaged_custom(folder: str, dice, flips: int) -> None:
    """Start a machine with each damage to the user's own Python."""
    file = folder + "/bytes_custom.py"
    whole = read(file)
    for spoilt in damages(whole, dice, flips):
        write(file, spoilt)

        def script(bench):
            yield from bench.lines(b"G0X0.1", b"G4P0", b"$I")

        bench = Bench("all", folder)
        bench.run(script)
        assert [line for line in bench.output if line.startswith("[Custom")], (
            spoilt,
            bench.output,
        )
    write(file, whole)


def damage_all(folder: str) -> int:
    """Damage every stored file many times and load it without a machine; then start one with all
    of
    them damaged. Return the number of damage reports."""
    kept = flash_files(folder)
    _restore(folder, {file: data for file, data in kept.items() if ".old" in file})
    for name in NAMES:
        now = folder + "/flash/" + name + ".txt"
        before = FlashStore(folder + "/flash/").load(name)
        for spoilt in damages(kept[name + ".txt"], Dice(5), 30):
            write(now, spoilt)
            assert FlashStore(folder + "/flash/").load(name) == before, spoilt
        write(now, b"\x80" + kept[name + ".txt"][1:])
    start_with_damaged_custom(folder, Dice(6), 6)
    _, said = view(folder)
    return len([line for line in said if "Damaged in flash" in line])


def main() -> None:
    """Run under MicroPython: talk in an empty folder, or damage the folder of a machine."""
    what, folder = sys.argv[1:]
    if what == "damage":
        print(damage_all(folder))
        return
    write_initial_files(folder)
    for name in MICROPYTHONS:
        print(name, send_foreign_bytes(name, folder, 7, 2))


if __name__ == "__main__":
    main()
