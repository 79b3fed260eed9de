"""Custom codes: G and M words that Grbl does not have, on lines of their own.

A line with such a word is passed to the function registered for it. All other lines are executed
as before.
"""

import micropython
from base import errors
from base import state as st
from base.errors import GrblError
from base.float32 import truncate
from language import block
from language.words import Words
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from talk.controller import Controller

    # The function, the letters of its numbers, whether it waits, all letters its line may have.
    Word = tuple[Callable[..., object], str, bool, str]
    # Letter, tenths of the number (G38.2: 382), tenths of its L if that is part of the word, else
    # 0.
    Key = tuple[str, int, int]

_G10 = const(100)  # in tenths
_GRBLS_L = (2, 20)


def word_of(letter: str, number: "float | str") -> "Key":
    """Return the key of a word: 81, 81.0 and "81" are the same. ValueError if not a number."""
    plain, _, its_l = str(number).partition(" L")
    return letter, _tenths(float(plain)), _tenths(float(its_l or 0))


def _tenths(number: float) -> int:
    return truncate(number * 10 + 0.5)


def is_grbls(letter: str, tenths: int) -> bool:
    """Return whether Grbl has that G or M word, or has an error of its own for its decimals."""
    number = tenths // 10
    if letter == "G" and number >= block.M_WORDS:
        return False
    decimals = block.decimals_of(number + block.M_WORDS if letter == "M" else number)
    if decimals < 0 or tenths % 10 == 0:
        return decimals >= 0 and decimals & block.NEEDED == 0
    return decimals & block.OTHERS == 0 or decimals & block.TENTHS & 1 << tenths % 10 - 1 > 0


class CustomCodes:
    """The added words. The first one wraps the execution of lines."""

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine
        self._words: "dict[Key, Word]" = {}
        self._read = Words(len(machine.reader.line))

    def is_taken(self, letter: str, number: "float | str") -> bool:
        """Return whether Grbl or an extra already has that G or M word."""
        key = word_of(letter, number)
        if key in self._words:
            return True
        is_free = key[1] == _G10 and key[2] and key[2] // 10 not in _GRBLS_L
        if letter == "G" and key[1] // 10 in self._machine.interpreter.motions:
            return True
        return is_grbls(letter, key[1]) and not is_free

    def add(
        self,
        letter: str,
        number: "float | str",
        call: "Callable[..., object]",
        letters: str,
        sync: bool,
    ) -> None:
        """Add a word; see Cnc.add_m(). ValueError if the word is taken."""
        if self.is_taken(letter, number):
            raise ValueError("%s%s is taken" % (letter, number))
        if not self._words:
            self._wrap_lines()
        key = word_of(letter, number)
        self._words[key] = call, letters, sync, letters.upper() + ("NL" if key[2] else "N")

    def _wrap_lines(self) -> None:
        hooks = self._machine.state.hooks
        usual = hooks.execute

        @micropython.native
        def execute(line: bytearray, length: int) -> None:
            word = self.find(line, length)
            if word is None:
                usual(line, length)
            else:
                numbers = self._numbers(word)
                if self._machine.state.run != st.CHECK:
                    word[0](*numbers)

        hooks.execute = execute

    def find(self, line: bytearray, length: int) -> "Word | None":
        """Return the added word on this line, or None."""
        words = self._read
        words.read(line, 0, length)
        count = words.count
        at = words.letters.find(b"L", 0, count)
        its_l = _tenths(words.values[at]) if at >= 0 else 0
        for i in range(count):
            letter, tenths = "%c" % words.letters[i], _tenths(words.values[i])
            word = self._words.get((letter, tenths, its_l)) or self._words.get((letter, tenths, 0))
            if word:
                return word
        return None

    def _numbers(self, word: "Word") -> "list[float | None]":
        """Check the line, wait for motion to end if the word wants that, return its numbers."""
        _, letters, sync, allowed = word
        there = self._arguments(allowed)
        missing = [c for c in letters if c == c.upper() and there.get(c) is None]
        if missing:
            raise GrblError(errors.GCODE_VALUE_WORD_MISSING)
        if sync:
            self._machine.canon.synchronise()
        return [there.get(c.upper()) for c in letters]

    def _arguments(self, allowed: str) -> "dict[str, float]":
        """Return the line's numbers by letter. GrblError for a wrong or repeated letter."""
        words = self._read
        found: "dict[str, float]" = {}
        own = 0
        for i in range(words.count):
            letter, value = "%c" % words.letters[i], words.values[i]
            if letter in "GM":
                own += 1
            elif letter in found:
                raise GrblError(errors.GCODE_WORD_REPEATED)
            elif letter not in allowed:
                raise GrblError(errors.GCODE_UNUSED_WORDS)
            else:
                found[letter] = value
        if words.fault:
            raise GrblError(words.fault)
        if own != 1:
            raise GrblError(errors.GCODE_MODAL_GROUP_VIOLATION)
        return found
