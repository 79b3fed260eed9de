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


def key_of(letter: str, number: "float | str") -> "Key":
    """Return the key of a word: the same for 81, 81.0 and "81". "10 L1" is G10 with L1. ValueError
    if `number` is not a number."""
    code, _, l_number = str(number).partition(" L")
    return letter, _tenths(float(code)), _tenths(float(l_number or 0))


def _tenths(number: float) -> int:
    """Return the number of a word in tenths, rounded: 382 for 38.2."""
    return truncate(number * 10 + 0.5)


def is_grbls(letter: str, tenths: int) -> bool:
    """Return whether Grbl has that G or M word, or an error other than "unsupported" for it.

    tenths: the word's number in tenths.
    """
    number, decimal = tenths // 10, tenths % 10
    if letter == "G" and number >= block.M_WORDS:
        return False
    # A mask of the decimals that Grbl has for this number, or -1 if it does not have the number.
    # TENTHS: bit n stands for .n. NEEDED: the number without a decimal is no word.
    # OTHERS: Grbl only calls other decimals "unsupported", so an extra may use them.
    decimals = block.decimals_of(number + block.M_WORDS if letter == "M" else number)
    if decimals < 0:
        return False
    if decimal == 0:
        return not decimals & block.NEEDED
    has_decimal = bool(decimals & block.TENTHS & 1 << decimal)
    others_are_free = decimals & block.OTHERS
    return has_decimal or not others_are_free


class CustomCodes:
    """The added words, by key. The first one that is added wraps the execution of lines.
    _line: the words of the line that find() has read last."""

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine
        self._words: "dict[Key, Word]" = {}
        self._line = Words(len(machine.reader.line))

    def is_taken(self, letter: str, number: "float | str") -> bool:
        """Return whether Grbl or an extra already has that word: letter G or M, number as in
        add()."""
        key = key_of(letter, number)
        if key in self._words:
            return True
        _, tenths, l_tenths = key
        if letter == "G" and tenths // 10 in self._machine.interpreter.motions:
            return True  # a canned cycle of an extra
        if not is_grbls(letter, tenths):
            return False
        # G10 is Grbl's, but only with L2 and L20.
        is_free_g10 = tenths == _G10 and l_tenths and l_tenths // 10 not in (2, 20)
        return not is_free_g10

    def add(
        self,
        letter: str,
        number: "float | str",
        call: "Callable[..., object]",
        letters: str,
        sync: bool,
    ) -> None:
        """Add a word: letter G or M, and its number, or "10 L1" for G10 with L1. call gets the
        numbers of `letters`, of which lower-case ones are optional; sync: it waits for the end of
        motion. ValueError if the word is taken."""
        if self.is_taken(letter, number):
            raise ValueError("%s%s is already in use" % (letter, number))
        if not self._words:
            self._wrap_lines()
        key = key_of(letter, number)
        has_l = key[2] > 0  # tenths of its L
        allowed = letters.upper() + ("NL" if has_l else "N")  # N: any line may have a number
        self._words[key] = call, letters, sync, allowed

    def _wrap_lines(self) -> None:
        """Execute lines with an added word here, all others as before."""
        hooks = self._machine.state.hooks
        previous = hooks.execute

        @micropython.native
        def execute(line: bytearray, length: int) -> None:
            """Execute a line; one with an added word is only checked in check mode."""
            word = self.find(line, length)
            if word is None:
                previous(line, length)
            else:
                numbers = self._numbers(word)
                if self._machine.state.run != st.CHECK:
                    call = word[0]  # see Word
                    call(*numbers)

        hooks.execute = execute

    def find(self, line: bytearray, length: int) -> "Word | None":
        """Return the added word on this line, or None. A word may be added for one value of L, as
        G10 L1: with that L on the line it takes precedence. The words read stay in _line."""
        words = self._line
        words.read(line, 0, length)
        count = words.count
        index_of_l = words.letters.find(b"L", 0, count)
        l_tenths = _tenths(words.values[index_of_l]) if index_of_l >= 0 else 0
        for i in range(count):
            letter, tenths = "%c" % words.letters[i], _tenths(words.values[i])
            with_l = self._words.get((letter, tenths, l_tenths))
            word = with_l or self._words.get((letter, tenths, 0))  # 0: the one for any L
            if word:
                return word
        return None

    def _numbers(self, word: "Word") -> "list[float | None]":
        """Check the line read last, and return its numbers in the order of the word's letters.

        word: as add() has stored it. None stands for an optional letter (lower case) that the line
        does not have. If the word waits for motion, this returns when motion has ended. GrblError
        if the line is wrong.
        """
        _, letters, sync, allowed = word
        numbers = self._arguments(allowed)  # by capital letter
        missing = [letter for letter in letters if letter.isupper() and letter not in numbers]
        if missing:
            raise GrblError(errors.GCODE_VALUE_WORD_MISSING)
        if sync:
            self._machine.canon.synchronise()
        return [numbers.get(letter.upper()) for letter in letters]

    def _arguments(self, allowed: str) -> "dict[str, float]":
        """Return the numbers of the line read last, by letter. allowed: letters it may have.

        GrblError for another letter, a repeated one, or a second G or M word.
        """
        words = self._line
        numbers: "dict[str, float]" = {}
        codes = 0  # G and M words on the line
        for i in range(words.count):
            letter, value = "%c" % words.letters[i], words.values[i]
            if letter in "GM":
                codes += 1
            elif letter in numbers:
                raise GrblError(errors.GCODE_WORD_REPEATED)
            elif letter not in allowed:
                raise GrblError(errors.GCODE_UNUSED_WORDS)
            else:
                numbers[letter] = value
        if words.fault:
            raise GrblError(words.fault)
        if codes != 1:
            raise GrblError(errors.GCODE_MODAL_GROUP_VIOLATION)
        return numbers
