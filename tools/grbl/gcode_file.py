"""Program files as senders see them: lines of bytes, cut at CRLF, LF or CR."""

import re
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from ..paths import why
from .lines import Changed, Lines

# Bytes that Grbl takes off before it looks at lines. Those from 0x80 on are all its own.
STATUS = b"?"
CYCLE_START = b"~"
FEED_HOLD = b"!"
RESET = b"\x18"
JOG_CANCEL = b"\x85"
STDIN = "-"

_REALTIME = re.compile(rb"[?~!\x18\x80-\xff]")
# What no editor writes. Paper tapes of old machines begin and end with some (DC1 to DC4).
_NO_TEXT = re.compile(rb"[\0-\x08\x0e-\x10\x15-\x17\x19\x1b-\x1f]")
_SHOWN = 120
# As Grbl reads them: a comment in parentheses may be left open, and ; ends a line outside of them.
_COMMENT = re.compile(rb"\([^)]*\)?|;.*", re.DOTALL)
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_DASHES = "\u2212\u2013\u2014\u2010\u2011\uff0d"  # of word processors and web pages
_ENDS = b"%"  # of a paper tape
_FOREIGN = re.compile(
    rb"^(?:N\d+)?O\d+$|T\d|M0*6(?!\d)|G(?:43|49|61\.1|64|73|8[0-359]|9[89])(?![\d.])|G0*4S"
)
# Of languages that no option takes, without spaces.
_LANGUAGES = {
    "a Heidenhain control": re.compile(
        rb"^\d*(?:BEGINPGM|ENDPGM|BLKFORM|TOOL(?:CALL|DEF)|CYCLDEF|CALLLBL|LBL|CC?[XYZ][+-]|L[A-Z])"
    ),
    "a 3D printer": re.compile(
        rb"^(?:N\d+)?(?:M(?:8[234]|10[4-9]|117|140|190|20[1-5]|22[01])(?!\d)|G29(?!\d)|G0*[01]\D.*E-?\.?\d)"
    ),
}
_MARK = b"\xef\xbb\xbf"  # how some editors begin a file in UTF-8
_NAMES = {
    b"?": "the question mark asks for a status report",
    b"~": "~ is a cycle start",
    b"!": "! is a feed hold",
    b"\x18": "Ctrl-X is a reset",
}
# What comments hold instead of what would act.
_HARMLESS = str.maketrans({"?": ".", "!": ".", "~": "-", "ß": "ss", "Ø": "O", "ø": "o", "µ": "u"})


class Problem(NamedTuple):
    """A line (from 1) with bytes that act at once. in_comment: they can be left out."""

    line: int
    text: str
    in_comment: bool


class NotText(ValueError):
    """A file that is no program: empty, or not made of text."""


def name_of(path: Path) -> str:
    """What people call a program."""
    return "stdin" if str(path) == STDIN else path.name


def read_bytes(path: Path) -> bytes:
    """What is in a file, `-` is stdin. OSError says in words why it cannot be read."""
    try:
        return sys.stdin.buffer.read() if str(path) == STDIN else path.read_bytes()
    except OSError as error:
        raise OSError(f"{path} cannot be read: {why(error)}") from error


def read_utf8(path: Path) -> bytes:
    """As read_bytes(); what is in UTF-16, by its first two bytes, is in UTF-8 then. ValueError
    where it is broken."""
    data = read_bytes(path)
    if data[:2] not in _UTF_16:
        return data.removeprefix(_MARK)
    try:
        return data.decode("utf-16").encode()
    except UnicodeDecodeError as error:
        raise NotText(f"{name_of(path)} begins as UTF-16, and is broken") from error


def read_lines(path: Path) -> Lines:
    """The lines of a program file, `-` is stdin; line n of the file is element n - 1."""
    return Lines(read_utf8(path))


def check_text(lines: Sequence[bytes], name: str) -> None:
    """NotText where no program can be in it."""
    if not any(line.strip() for line in lines):
        raise NotText(f"{name} is empty: there is nothing to do")
    for number, line in enumerate(lines, 1):
        if not is_text(line):
            raise NotText(f"{name} is no G-code: line {number} holds bytes that are no text")


def check_utf8(data: bytes, name: object) -> None:
    """NotText where something else than text in UTF-8 is in it."""
    if not (is_text(data) and is_utf8(data)):
        raise NotText(f"{name} cannot be read: it is no text in UTF-8; save it as that")


def is_foreign(line: bytes) -> bool:
    """Whether words of other controllers are in it that LENIENT takes."""
    return bool(_FOREIGN.search(_bare(line)))


def language_of(line: bytes) -> str:
    """Whose language it is, where it is none of a Grbl's kind; else an empty text."""
    bare = _bare(line)
    return next((whose for whose, words in _LANGUAGES.items() if words.search(bare)), "")


def _bare(line: bytes) -> bytes:
    return without_comments(line).replace(b" ", b"").upper()


def read_program(path: Path) -> Sequence[bytes]:
    """As read_lines(), but for what marks the ends of a file; ValueError where there is nothing to
    run, or what is there is no text."""
    lines = read_lines(path)
    check_text(lines, name_of(path))
    return Changed(lines, without_end)


def without_end(line: bytes) -> bytes:
    """The line, empty where it only marks an end of the file."""
    return b"" if _ENDS in line and line.strip() == _ENDS else line


def has_realtime(line: bytes) -> bool:
    """Whether a line holds bytes that act at once, before the lines in front of it are done."""
    return _REALTIME.search(line) is not None


def without_comments(line: bytes) -> bytes:
    """What a Grbl acts upon."""
    return _COMMENT.sub(b"", line)


def comment(line: bytes) -> str:
    """What a line says to people."""
    found = b" ".join(_COMMENT.findall(line))
    return text(found).translate({ord(sign): " " for sign in "();"}).strip()


def sanitize(line: bytes) -> bytes:
    """The line, with comments in which nothing acts: letters in ASCII, and no ! ~ ? or Ctrl-X."""
    if not has_realtime(line):
        return line
    return _COMMENT.sub(lambda match: _plain(match[0]), line)


def text(line: bytes) -> str:
    """A line as it is shown: in UTF-8 as programs of today are, or in Latin-1."""
    return line.decode("utf-8" if is_utf8(line) else "latin-1").strip()


def is_text(data: bytes) -> bool:
    """Whether nothing is in it that no editor writes."""
    return _NO_TEXT.search(data) is None


def is_utf8(data: bytes) -> bool:
    """Whether it can be."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def shown(line: bytes) -> str:
    """As text(), cut where a line is long."""
    whole = text(line)
    return whole if len(whole) <= _SHOWN else f"{whole[:_SHOWN]} …"


def problems(lines: Iterable[bytes]) -> list[Problem]:
    """Where a program holds bytes that a Grbl would act upon at once."""
    found = []
    for number, line in enumerate(lines, 1):
        if not (act := _REALTIME.search(line)):
            continue
        if code := _REALTIME.search(without_comments(line)):
            found.append(Problem(number, _what(without_comments(line), code[0]), False))
        else:
            found.append(Problem(number, f"{_what(line, act[0])} in a comment", True))
    return found


def _what(line: bytes, byte: bytes) -> str:
    if byte in _NAMES:
        return _NAMES[byte]
    sign = next((sign for sign in text(line) if not sign.isascii()), "")
    if sign and sign in _DASHES:
        return f"{sign!r} is no minus: write -"
    return f"{sign!r} holds bytes that are real-time commands"


def _plain(part: bytes) -> bytes:
    letters = unicodedata.normalize("NFKD", text(part).translate(_HARMLESS))
    return bytes(byte for byte in letters.encode("ascii", "ignore") if byte >= 0x20)


def is_answer(line: str) -> bool:
    """Whether a line from Grbl answers a line sent to it."""
    return line == "ok" or line.startswith("error:")


def is_welcome(line: str) -> bool:
    """Whether a line says that a Grbl, or a grblHAL, has started."""
    return line.startswith("Grbl")
