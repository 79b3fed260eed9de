"""Tables of what can be sent: G and M words, $ commands, real-time bytes."""

import re
from functools import cache

from .. import paths
from ..grbl.comments import source
from . import meanings
from .markdown import table

_GROUP = re.compile(r"^GROUP_\w+ = const\((0x\w+)\)  # (.*)$", re.MULTILINE)
_COMMAND = re.compile(r"^ +\d+: self\.\w+,  # (\$\S+)$", re.MULTILINE)


@cache
def _group_names() -> dict[int, str]:
    return {int(bit, 16): name for bit, name in _GROUP.findall(source("language/block"))}


def _group(word: str) -> str:
    """The modal group that the interpreter puts a word in."""
    from control.modes import Modal
    from language.block import Block
    from language.words import Words

    words = Words()
    words.read(bytearray(word.encode() + b"\0"), 0, len(word))
    block = Block(3, has_mist=True, has_override_control=True)
    block.begin(Modal())
    block.take(words)
    return _group_names()[block.commands]


def g_words() -> list[str]:
    """Every G word that the interpreter knows, in order."""
    paths.use_firmware()
    from language import block

    found = []
    for number in block.G_WORDS:
        if number not in block._WANTS_DECIMALS:
            found.append(f"G{number}")
        tenths = block._G_DECIMALS.get(number, 0)
        found += [f"G{number}.{part}" for part in range(10) if tenths >> part & 1]
    return found


def m_words() -> list[str]:
    """Every M word that the interpreter knows, options of the board included."""
    paths.use_firmware()
    from language import block

    return [f"M{number}" for number in block.M_WORDS]


def _at_start(word: str) -> bool:
    """A mode that a reset puts in force."""
    from control.modes import Modal
    from language.block import G_WORDS, GROUP_M4, M_WORDS

    if "." in word:
        return False
    rows = G_WORDS if word[0] == "G" else M_WORDS
    group, name, value, *_ = rows[int(word[1:])]
    return bool(name) and group != GROUP_M4 and getattr(Modal(), str(name)) == value


def _words_table(words: list[str], said: dict[str, str]) -> str:
    rows = []
    for word in words:
        start = " In force at start." if _at_start(word) else ""
        rows.append((f"`{word}`", _group(word), said[word] + start))
    return table(("Word", "Group", "Meaning"), rows)


def g_table() -> str:
    """G words with their groups; KeyError where one has no meaning."""
    return _words_table(g_words(), meanings.G_MEANINGS)


def m_table() -> str:
    """M words with their groups; KeyError where one has no meaning."""
    return _words_table(m_words(), meanings.M_MEANINGS)


def commands() -> list[str]:
    """The commands that begin with $, as the firmware's table of them says."""
    return _COMMAND.findall(source("talk/commands"))


def commands_table() -> str:
    """$ commands; KeyError where one has no meaning."""
    rows = [("`$`", "Show this list, in short."), ("`$n=value`", "Change setting n.")]
    rows.append(("`$J=words`", "Jog: a motion that a hold or jog cancel ends for good."))
    rows += [(f"`{command}`", meanings.COMMANDS[command]) for command in commands()]
    return table(("Command", "What it does"), rows)


def _byte(number: int) -> str:
    return f"`0x{number:02X}`" + (f" `{chr(number)}`" if 0x20 < number < 0x7F else "")


def realtime_table() -> str:
    """Real-time bytes; KeyError where one has no meaning."""
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
        sets = which == overrides._RAPID or change == 0
        amount = f"{change or 100} % of normal" if sets else f"{change:+d} %"
        rows.append((_byte(number), f"{names[which]}: {amount}."))
    rows.append((_byte(overrides._SPINDLE_STOP), "Spindle stop, on and off; in a hold only."))
    rows.append((_byte(overrides._FLOOD_TOGGLE), "Flood coolant on and off."))
    mist = "Mist coolant on and off. Board option `MIST`."
    rows.append((_byte(overrides._MIST_TOGGLE), mist))
    return table(("Byte", "What it does"), rows)
