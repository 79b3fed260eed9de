"""Tables of the input: G and M words, $ commands, real-time bytes."""

import re
from array import array
from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING

from .. import paths
from ..grbl.comments import source
from . import meanings
from .markdown import table

if TYPE_CHECKING:
    from language.block import Block

_GROUP = re.compile(r"^GROUP_\w+ = const\((0x\w+)\)  # (.*)$", re.MULTILINE)
_COMMAND = re.compile(r"^ +\d+: self\.\w+,  # (\$\S+)$", re.MULTILINE)


@cache
def _group_names() -> dict[int, str]:
    return {int(bit, 16): name for bit, name in _GROUP.findall(source("language/block_layout"))}


def _block_of(word: str, modal: "array[int]") -> "Block | None":
    """Return the block that the interpreter makes of a word in that modal state; None if it
    refuses it."""
    from language.block import Block, read

    block = Block(b"XYZ", has_mist=True, has_override_control=True)
    line = bytearray(word.encode() + b"\0")
    start, end = 0, len(word)
    span = end << 8 | start
    parsed_values = block.ints, block.singles, block.xyz, block.axes  # read() fills them
    error = read(line, span, modal, *parsed_values, block.words)  # 0: accepted
    return None if error else block


def _at_reset() -> "array[int]":
    """Return the modal state after a reset."""
    from control.modes import Modes

    return Modes(axes=3).modal


def _known(words: "Iterable[str]") -> list[str]:
    """Return those of the words that the interpreter accepts after a reset."""
    paths.use_firmware()
    modal = _at_reset()
    return [word for word in words if _block_of(word, modal)]


def _group(word: str) -> str:
    """Return the modal group of a word, according to the interpreter."""
    from language.block_layout import COMMANDS

    block = _block_of(word, _at_reset())
    assert block
    return _group_names()[block.ints[COMMANDS]]


def g_words() -> list[str]:
    """Return every G word that the interpreter knows, in order."""
    tenths = ("", *(f".{tenth}" for tenth in range(1, 10)))
    words = [f"G{number}{tenth}" for number in range(100) for tenth in tenths]
    # read as G49, as in Grbl
    return [word for word in _known(words) if not word.startswith("G49.")]


def m_words() -> list[str]:
    """Return every M word that the interpreter knows, including options of the board."""
    return _known(f"M{number}" for number in range(256))


def _at_start(word: str) -> bool:
    """Return whether a word is a mode that is active after a reset: it sets a modal value to the
    one that is there after a reset."""
    from control.modes import MODAL_LENGTH, MODAL_ROOM, PROGRAM_FLOW

    no_mode = 99  # the value of no mode, so that every change is seen
    before = array("i", [no_mode] * MODAL_LENGTH + [0] * (MODAL_ROOM - MODAL_LENGTH))
    block = _block_of(word, before)
    assert block
    # A block's first integers are the modal values after it.
    set_to = {i: block.ints[i] for i in range(MODAL_LENGTH) if block.ints[i] != before[i]}
    at_reset = _at_reset()
    return any(i != PROGRAM_FLOW and at_reset[i] == value for i, value in set_to.items())


def _words_table(words: list[str], meanings: dict[str, str]) -> str:
    """Return a Markdown table of words with their groups and meanings."""
    rows = []
    for word in words:
        start = " In force at start." if _at_start(word) else ""
        rows.append((f"`{word}`", _group(word), meanings[word] + start))
    return table(("Word", "Group", "Meaning"), rows)


def g_table() -> str:
    """Return G words with their groups; KeyError if one has no meaning."""
    return _words_table(g_words(), meanings.G_MEANINGS)


def m_table() -> str:
    """Return M words with their groups; KeyError if one has no meaning."""
    return _words_table(m_words(), meanings.M_MEANINGS)


def commands() -> list[str]:
    """Return the commands that begin with $, from the firmware's table."""
    return _COMMAND.findall(source("talk/commands"))


def commands_table() -> str:
    """Return $ commands; KeyError if one has no meaning."""
    rows = [("`$`", "Show this list, in short."), ("`$n=value`", "Change setting n.")]
    rows.append(("`$J=words`", "Jog: a motion that a hold or jog cancel ends for good."))
    rows += [(f"`{command}`", meanings.COMMANDS[command]) for command in commands()]
    return table(("Command", "What it does"), rows)


def _byte(number: int) -> str:
    return f"`0x{number:02X}`" + (f" `{chr(number)}`" if 0x20 < number < 0x7F else "")


def realtime_table() -> str:
    """Return real-time bytes; KeyError if one has no meaning."""
    paths.use_firmware()
    from base import state
    from control import overrides, realtime

    rows = [(f"{_byte(realtime._SOFT_RESET)} Ctrl-X", meanings.RESET)]
    rows += [(_byte(number), meanings.EVENTS[number]) for number in (*state.EVENTS,)]
    names = {
        overrides._FEED: "Feed rate",
        overrides._RAPID: "Rapids",
        overrides._SPINDLE: "Spindle speed",
    }
    for number, (which, change) in overrides._OVERRIDES.items():
        # Rapids are set to a percentage; the others are changed by it, and by 0 set to 100 %.
        is_absolute = which == overrides._RAPID or change == 0
        amount = f"{change or 100} % of normal" if is_absolute else f"{change:+d} %"
        rows.append((_byte(number), f"{names[which]}: {amount}."))
    rows.append((_byte(overrides._SPINDLE_STOP), "Spindle stop, on and off; in a hold only."))
    rows.append((_byte(overrides._FLOOD_TOGGLE), "Flood coolant on and off."))
    mist = "Mist coolant on and off. Board option `MIST`."
    rows.append((_byte(overrides._MIST_TOGGLE), mist))
    return table(("Byte", "What it does"), rows)
