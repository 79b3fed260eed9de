"""An independent, plain and slow implementation of Grbl 1.1h's rules for a block, for tests only.

judge() returns the error number of a line, 0 for "ok", and updates modal state, offsets and the
parser's position as real Grbl would in check mode ("$C") or, for jogs, while idle. Numbers are
rounded to single precision at every step, as on Grbl's chip.
"""

import struct
from math import inf, sqrt, trunc

# Which command of a block uses the axis words.
NOBODY, NON_MODAL, MOTION, LENGTH = range(4)

PLANES = {17: ("X", "Y"), 18: ("Z", "X"), 19: ("Y", "Z")}
# The modal group of a G or M code; two of one group get error 21.
G_GROUPS = {
    **dict.fromkeys((4, 10, 28, 30, 53, 92), "non-modal"),
    **dict.fromkeys((0, 1, 2, 3, 38, 80), "motion"),
    **dict.fromkeys((17, 18, 19), "plane"),
    **dict.fromkeys((90, 91), "distance"),
    **dict.fromkeys((93, 94), "feed mode"),
    **dict.fromkeys((20, 21), "units"),
    **dict.fromkeys((43, 49), "length"),
    **dict.fromkeys((54, 55, 56, 57, 58, 59), "system"),
    40: "cutter",
    61: "control",
}
M_GROUPS = {
    **dict.fromkeys((0, 1, 2, 30), "flow"),
    **dict.fromkeys((3, 4, 5), "spindle"),
    **dict.fromkeys((8, 9), "coolant"),
}
NOT_NEGATIVE = "FNPST"
MM_PER_INCH = struct.unpack("f", struct.pack("f", 25.4))[0]


class Refused(Exception):
    """The line gets error:<args[0]>."""


def single(x: float) -> float:
    """Return x rounded to single precision."""
    try:
        return struct.unpack("f", struct.pack("f", x))[0]
    except OverflowError:
        return inf


def rounded(x: float) -> int:
    """Round like C's round(): halves away from zero; the result is unsigned 16 bits."""
    return (trunc(x + 0.5) if x >= 0 else trunc(x - 0.5)) & 0xFFFF


def hypotenuse(x: float, y: float) -> float:
    return single(sqrt(single(single(x * x) + single(y * y))))


def read_number(text: str) -> "tuple[int, float] | None":
    """Read a number like Grbl: eight digits count, the rest move the point. Return length and
    value."""
    pos = 0
    if text[:1] in ("-", "+"):
        pos = 1
    number = exponent = digits = 0
    point = False
    while pos < len(text):
        c = text[pos]
        if c in "0123456789":
            digits += 1
            if digits <= 8:
                number = number * 10 + int(c)
                exponent -= point
            elif not point:
                exponent += 1
        elif c == "." and not point:
            point = True
        else:
            break
        pos += 1
    if not digits:
        return None
    value = single(number)
    while value and exponent <= -2:
        value = single(value * single(0.01))
        exponent += 2
    if value and exponent < 0:
        value = single(value * single(0.1))
    while value and exponent > 0:
        value = single(value * 10.0)
        exponent -= 1
    return pos, -value if text[0] == "-" else value


def read_words(text: str) -> "tuple[list[tuple[str, float]], int]":
    """Return all words of a line, and the error after the last one."""
    found = []
    while text:
        if not "A" <= text[0] <= "Z":
            return found, 1
        number = read_number(text[1:])
        if number is None:
            return found, 2
        found.append((text[0], number[1]))
        text = text[1 + number[0] :]
    return found, 0


class Oracle:
    """Grbl's interpreter. The dictionaries are keyed by letters and by numbers of G codes."""

    def __init__(self) -> None:
        self.position = dict.fromkeys("XYZ", 0.0)
        self.systems = {n: dict.fromkeys("XYZ", 0.0) for n in (54, 55, 56, 57, 58, 59, 28, 30)}
        self.in_use = dict.fromkeys("XYZ", 0.0)  # offsets of the active system, as last read
        self.g92 = dict.fromkeys("XYZ", 0.0)
        self.length = 0.0
        self.motion = "G0"
        self.plane, self.units, self.distance, self.feed_mode = 17, 21, 90, 94
        self.system = 54
        self.spindle, self.flood = 5, False
        self.feed = self.speed = 0.0
        self.tool = 0

    def modes(self) -> str:
        """Return the output of "$G", without the numbers of F and S."""
        coolant = "M8" if self.flood else "M9"
        modes = f"{self.motion} G{self.system} G{self.plane} G{self.units} G{self.distance}"
        return f"{modes} G{self.feed_mode} M{self.spindle} {coolant} T{self.tool}"

    def judge(self, line: str) -> int:
        """Return the error number of a line of words: upper case, without spaces and comments."""
        block = Block(self, line.startswith("$J="))
        try:
            block.read(line.removeprefix("$J="))
            block.check()
            if block.jog:
                block.check_jog()
        except Refused as refusal:
            return refusal.args[0]
        if block.jog:
            self.position = block.target
        else:
            block.execute()
        return 0


class Block:
    """One line during the checks."""

    def __init__(self, grbl: Oracle, jog: bool) -> None:
        self.grbl = grbl
        self.jog = jog
        self.groups: set[str] = set()
        self.words: dict[str, float] = {}
        self.non_modal = ""
        self.claim = NOBODY
        self.motion = "G1" if jog else grbl.motion
        self.plane, self.units, self.distance = grbl.plane, grbl.units, grbl.distance
        self.feed_mode = 94 if jog else grbl.feed_mode
        self.length_mode = ""
        self.system = grbl.system
        self.spindle, self.flood, self.flow = grbl.spindle, grbl.flood, 1
        self.target = dict(grbl.position)

    # Words, one by one: the first wrong one gives the error.

    def read(self, text: str) -> None:
        words, fault = read_words(text)
        for letter, value in words:
            code = trunc(value) & 255
            hundredths = rounded(single(100 * single(value - code)))
            if letter == "G":
                self.take_g(code, hundredths)
            elif letter == "M":
                self.take_m(code, hundredths)
            else:
                self.take_value(letter, value)
        if fault:
            raise Refused(fault)

    def take_g(self, code: int, hundredths: int) -> None:
        if code not in G_GROUPS:
            raise Refused(20)
        group = G_GROUPS[code]
        if group == "motion" and code != 80:
            self.claims(MOTION)
        elif group == "length":
            self.claims(LENGTH)
        elif code in (10, 28, 30, 92) and hundredths == 0:
            self.claims(NON_MODAL)
        name = f"G{code}"
        if code in (28, 30, 92, 90, 91, 61, 38, 43) and (hundredths or code in (38, 43)):
            allowed = {28: (10,), 30: (10,), 92: (10,), 91: (10,), 38: (20, 30, 40, 50), 43: (10,)}
            if hundredths not in allowed.get(code, ()):
                raise Refused(20)
            name += f".{hundredths // 10}"
        elif hundredths and code != 49:
            raise Refused(23)
        if name == "G91.1":
            group = "arc distance"
        self.joins(group)
        if group == "motion":
            self.motion = name
        elif group == "non-modal":
            self.non_modal = name
        elif group == "length":
            self.length_mode = name
        elif group in ("plane", "units", "distance", "system"):
            setattr(self, group, code)
        elif group == "feed mode":
            self.feed_mode = code

    def take_m(self, code: int, hundredths: int) -> None:
        if hundredths:
            raise Refused(23)
        if code not in M_GROUPS:
            raise Refused(20)
        group = M_GROUPS[code]
        self.joins(group)
        if group == "coolant":
            self.flood = code == 8
        else:
            setattr(self, group, code)

    def claims(self, who: int) -> None:
        if self.claim:
            raise Refused(24)
        self.claim = who

    def joins(self, group: str) -> None:
        if group in self.groups:
            raise Refused(21)
        self.groups.add(group)

    def take_value(self, letter: str, value: float) -> None:
        if letter not in "XYZIJKFLNPRST":
            raise Refused(20)
        if letter == "T" and value > 255:
            raise Refused(38)
        if letter in self.words:
            raise Refused(25)
        if letter in NOT_NEGATIVE and value < 0:
            raise Refused(4)
        self.words[letter] = value

    # Rules for the whole block

    def axes(self) -> str:
        return "".join(letter for letter in "XYZ" if letter in self.words)

    def mm(self, letter: str) -> float:
        value = self.words.get(letter, 0.0)
        return single(value * MM_PER_INCH) if self.units == 20 else value

    def check(self) -> None:
        self.unused = set(self.words) - {"N", "F"} - (set() if self.jog else {"S", "T"})
        if self.axes() and not self.claim:
            self.claim = MOTION
        if trunc(self.words.get("N", 0)) > 10_000_000:
            raise Refused(27)
        self.check_feed()
        if self.non_modal == "G4":
            if "P" not in self.words:
                raise Refused(28)
            self.unused -= {"P"}
        if self.length_mode == "G43.1" and self.axes() != "Z":
            raise Refused(37)
        self.find_target()
        # Before the motion check, which may drop the claim: a claim without axis words uses none.
        self.check_motion()
        if self.claim:
            self.unused -= set("XYZ")
        if self.unused:
            raise Refused(36)

    def check_feed(self) -> None:
        moves = self.claim == MOTION and self.motion not in ("G0", "G80")
        if "F" not in self.words and (self.jog or (self.feed_mode == 93 and moves)):
            raise Refused(22)
        self.feed = self.words.get("F", 0.0)
        if self.jog or (self.feed_mode == 94 and self.grbl.feed_mode == 94):
            self.feed = self.mm("F") if "F" in self.words else self.grbl.feed

    def find_target(self) -> None:
        grbl = self.grbl
        self.offsets = grbl.in_use if self.system == grbl.system else grbl.systems[self.system]
        if self.non_modal in ("G10", "G92"):
            if not self.axes():
                raise Refused(26)
            if self.non_modal == "G10":
                self.check_g10()
            else:
                self.new_g92 = {**grbl.g92, **self.offsets_here(self.offsets)}
            return
        if self.claim != LENGTH and self.axes():
            self.target = {letter: self.place(letter) for letter in "XYZ"}
        elif self.jog:
            self.target = dict.fromkeys("XYZ", 0.0)  # a jog without axis words goes to zero
        if self.non_modal in ("G28", "G30"):
            stored = grbl.systems[28 if self.non_modal == "G28" else 30]
            self.then = {
                letter: grbl.position[letter]
                if self.axes() and letter not in self.words
                else stored[letter]
                for letter in "XYZ"
            }
            if not self.axes():
                self.claim = NOBODY
        elif self.non_modal == "G53" and self.motion not in ("G0", "G1"):
            raise Refused(30)

    def place(self, letter: str) -> float:
        """Return an axis' target in machine coordinates."""
        grbl = self.grbl
        if letter not in self.words:
            return grbl.position[letter]
        value = self.mm(letter)
        if self.non_modal == "G53":
            return value
        if self.distance == 91:
            return single(value + grbl.position[letter])
        value = single(value + single(self.offsets[letter] + grbl.g92[letter]))
        return single(value + grbl.length) if letter == "Z" else value

    def offsets_here(self, other: "dict[str, float]") -> "dict[str, float]":
        """Return offsets that, with the others, make the current position read as the axis
        words."""
        grbl = self.grbl
        found = {}
        for letter in self.axes():
            x = single(single(grbl.position[letter] - other[letter]) - self.mm(letter))
            found[letter] = single(x - grbl.length) if letter == "Z" else x
        return found

    def check_g10(self) -> None:
        if "P" not in self.words and "L" not in self.words:
            raise Refused(28)
        number = trunc(self.words.get("P", 0)) & 255
        if number > 6:
            raise Refused(29)
        how = trunc(self.words.get("L", 0)) & 255
        if how not in (2, 20) or (how == 2 and "R" in self.words):
            raise Refused(20)
        self.unused -= {"P", "L"}
        self.stores = 53 + number if number else self.system
        old = self.grbl.systems[self.stores]
        new = {letter: self.mm(letter) for letter in self.axes()}
        self.stored = {**old, **(self.offsets_here(self.grbl.g92) if how == 20 else new)}

    def check_motion(self) -> None:
        if self.motion == "G80":
            if self.axes():
                raise Refused(31)
        elif self.claim == MOTION:
            if self.motion != "G0" and self.feed == 0:
                raise Refused(22)
            if self.motion in ("G0", "G1"):
                if not self.axes():
                    self.claim = NOBODY
                return
            if not self.axes():
                raise Refused(26)
            if self.motion in ("G2", "G3"):
                self.check_arc()
            elif self.target == self.grbl.position:
                raise Refused(33)

    def check_arc(self) -> None:
        one, other = PLANES[self.plane]
        if not {one, other} & set(self.words):
            raise Refused(32)
        x = single(self.target[one] - self.grbl.position[one])
        y = single(self.target[other] - self.grbl.position[other])
        if "R" in self.words:
            self.unused -= {"R"}
            if self.target == self.grbl.position:
                raise Refused(33)
            r = self.mm("R")
            square = single(single(4 * r) * r)
            if single(single(square - single(x * x)) - single(y * y)) < 0:
                raise Refused(34)
            return
        centre = [chr(ord(letter) - ord("X") + ord("I")) for letter in (one, other)]
        if not set(centre) & set(self.words):
            raise Refused(35)
        self.unused -= set("IJK")
        i, j = map(self.mm, centre)
        radius = hypotenuse(i, j)
        off = abs(single(hypotenuse(single(x - i), single(y - j)) - radius))
        if off > single(0.005) and (off > 0.5 or off > single(single(0.001) * radius)):
            raise Refused(33)

    def check_jog(self) -> None:
        if self.groups - {"non-modal", "distance", "units"} or self.non_modal not in ("", "G53"):
            raise Refused(16)

    # Effects of an accepted block

    def execute(self) -> None:
        grbl = self.grbl
        grbl.feed_mode, grbl.feed = self.feed_mode, self.feed
        grbl.speed = self.words.get("S", grbl.speed)
        grbl.tool = trunc(self.words.get("T", 0)) & 255
        grbl.spindle, grbl.flood = self.spindle, self.flood
        grbl.plane, grbl.units = self.plane, self.units
        if self.length_mode:
            grbl.length = self.mm("Z") if self.length_mode == "G43.1" else 0.0
        if self.system != grbl.system:
            grbl.system, grbl.in_use = self.system, grbl.systems[self.system]
        grbl.distance = self.distance
        self.execute_non_modal()
        grbl.motion = self.motion
        if self.claim == MOTION and self.motion != "G80":
            grbl.position = self.target
        if self.flow in (2, 30):
            grbl.motion = "G1"
            grbl.plane, grbl.distance, grbl.feed_mode = 17, 90, 94
            grbl.system, grbl.spindle, grbl.flood = 54, 5, False
            # Real Grbl, in check mode only, keeps adding the offsets of the former system.
            grbl.in_use = grbl.systems[54]

    def execute_non_modal(self) -> None:
        grbl = self.grbl
        what = self.non_modal
        if what == "G10":
            grbl.systems[self.stores] = self.stored
            if self.stores == grbl.system:
                grbl.in_use = self.stored
        elif what in ("G28", "G30"):
            grbl.position = self.then
        elif what in ("G28.1", "G30.1"):
            grbl.systems[28 if what == "G28.1" else 30] = dict(grbl.position)
        elif what == "G92":
            grbl.g92 = self.new_g92
        elif what == "G92.1":
            grbl.g92 = dict.fromkeys("XYZ", 0.0)
