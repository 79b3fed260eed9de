"""Program files as senders see them: lines of bytes, split at CRLF, LF or CR."""

import re
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from ..paths import why
from .lines import Changed, Lines

# Bytes that Grbl removes from the input before it reads lines. It also removes all from 0x80 on.
STATUS = b"?"
CYCLE_START = b"~"
FEED_HOLD = b"!"
RESET = b"\x18"
JOG_CANCEL = b"\x85"
STDIN = "-"

_REALTIME = re.compile(rb"[?~!\x18\x80-\xff]")
# Bytes that no editor writes. Paper tapes of old machines begin and end with others (DC1 to DC4).
_NO_TEXT = re.compile(rb"[\0-\x08\x0e-\x10\x15-\x17\x19\x1b-\x1f]")
_SHOWN = 120
# As Grbl reads them: a comment in parentheses may be left open, and ; begins a comment outside of
# them.
_COMMENT = re.compile(rb"\([^)]*\)?|;.*", re.DOTALL)
_UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_DASHES = "\u2212\u2013\u2014\u2010\u2011\uff0d"  # of word processors and web pages
_ENDS = b"%"  # of a paper tape
_FOREIGN = re.compile(
    rb"^(?:N\d+)?O\d+$|T\d|M0*6(?!\d)|G(?:43|49|61\.1|64|73|8[0-359]|9[89])(?![\d.])|G0*4S"
)
# Languages that no option supports; spaces are removed before matching.
_LANGUAGES = {
    "a Heidenhain control": re.compile(
        rb"^\d*(?:BEGINPGM|ENDPGM|BLKFORM|TOOL(?:CALL|DEF)|CYCLDEF|CALLLBL|LBL|CC?[XYZ][+-]|L[A-Z])"
    ),
    "a 3D printer": re.compile(
        rb"^(?:N\d+)?(?:M(?:8[234]|10[4-9]|117|140|190|20[1-5]|22[01])(?!\d)|G29(?!\d)|G0*[01]\D.*E-?\.?\d)"
    ),
}
_UTF_8_MARK = b"\xef\xbb\xbf"  # the mark with which some editors begin a file in UTF-8
_EFFECTS = {
    b"?": "the question mark asks for a status report",
    b"~": "~ is a cycle start",
    b"!": "! is a feed hold",
    b"\x18": "Ctrl-X is a reset",
}
# Replacements, in comments, of characters that would act or are not ASCII.
_HARMLESS = str.maketrans({"?": ".", "!": ".", "~": "-", "ß": "ss", "Ø": "O", "ø": "o", "µ": "u"})


class Problem(NamedTuple):
    """A line (from 1) with bytes that act at once. in_comment: they can be left out."""

    line: int
    text: str
    in_comment: bool


class NotText(ValueError):
    """A file that is not a program: empty, or not text."""


def name_of(path: Path) -> str:
    """Return the name of a program for messages."""
    return "stdin" if str(path) == STDIN else path.name


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; `-` is stdin. OSError says in words why it cannot be read."""
    try:
        return sys.stdin.buffer.read() if str(path) == STDIN else path.read_bytes()
    except OSError as error:
        raise OSError(f"{path} cannot be read: {why(error)}") from error


def read_utf8(path: Path) -> bytes:
    """Return the content of a file as read_bytes(), but converted to UTF-8 if its first two bytes
    mark UTF-16. ValueError if the encoding is broken."""
    data = read_bytes(path)
    if data[:2] not in _UTF_16_MARKS:
        return data.removeprefix(_UTF_8_MARK)
    try:
        return data.decode("utf-16").encode()
    except UnicodeDecodeError as error:
        raise NotText(
            f"{name_of(path)} begins as UTF-16, and is damaged; save it as UTF-8"
        ) from error


def read_lines(path: Path) -> Lines:
    """Return the lines of a program file, `-` is stdin; line n of the file is element n - 1."""
    return Lines(read_utf8(path))


def check_text(lines: Sequence[bytes], name: str) -> None:
    """Raise NotText if the lines cannot be a program."""
    if not any(line.strip() for line in lines):
        raise NotText(f"{name} is empty: there is nothing to do")
    for number, line in enumerate(lines, 1):
        if not is_text(line):
            raise NotText(f"{name} is no G-code: line {number} holds bytes that are no text")


def check_utf8(data: bytes, name: object) -> None:
    """Raise NotText if the data is not text in UTF-8."""
    if not (is_text(data) and is_utf8(data)):
        raise NotText(f"{name} cannot be read: it is no text in UTF-8; save it as UTF-8")


def is_foreign(line: bytes) -> bool:
    """Return whether it has words of other controllers that LENIENT accepts."""
    return bool(_FOREIGN.search(_bare(line)))


def language_of(line: bytes) -> str:
    """Return the name of a language that is not G-code for a Grbl; else ""."""
    bare = _bare(line)
    return next((whose for whose, words in _LANGUAGES.items() if words.search(bare)), "")


def _bare(line: bytes) -> bytes:
    """Return a line's G-code in capitals, without comments and spaces."""
    return without_comments(line).replace(b" ", b"").upper()


def read_program(path: Path) -> Sequence[bytes]:
    """Return the lines as read_lines(), but empty ones in place of lines that are only `%`.
    ValueError if there is nothing to run, or the file is not text."""
    lines = read_lines(path)
    check_text(lines, name_of(path))
    return Changed(lines, without_end)


def without_end(line: bytes) -> bytes:
    """Return the line, or b"" if it only marks an end of the file."""
    return b"" if _ENDS in line and line.strip() == _ENDS else line


def has_realtime(line: bytes) -> bool:
    """Return whether a line has bytes that act at once, before preceding lines are done."""
    return _REALTIME.search(line) is not None


def without_comments(line: bytes) -> bytes:
    """Return the part of a line that a Grbl executes."""
    return _COMMENT.sub(b"", line)


def comment(line: bytes) -> str:
    """Return the comments of a line."""
    found = b" ".join(_COMMENT.findall(line))
    return text(found).translate({ord(sign): " " for sign in "();"}).strip()


def sanitize(line: bytes) -> bytes:
    """Return the line with harmless comments: letters in ASCII, and no ! ~ ? or Ctrl-X."""
    if not has_realtime(line):
        return line
    return _COMMENT.sub(lambda match: _plain(match[0]), line)


def text(line: bytes) -> str:
    """Return a line for display: decoded from UTF-8, as most programs are, or from Latin-1."""
    return line.decode("utf-8" if is_utf8(line) else "latin-1").strip()


def is_text(data: bytes) -> bool:
    """Return whether it has only bytes that editors write."""
    return _NO_TEXT.search(data) is None


def is_utf8(data: bytes) -> bool:
    """Return whether the data can be decoded as UTF-8."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def shown(line: bytes) -> str:
    """Return text(), shortened if the line is long."""
    whole = text(line)
    return whole if len(whole) <= _SHOWN else f"{whole[:_SHOWN]} …"


def problems(lines: Iterable[bytes]) -> list[Problem]:
    """Return the lines with bytes that a Grbl would execute at once."""
    found = []
    for number, line in enumerate(lines, 1):
        if not (anywhere := _REALTIME.search(line)):
            continue
        code = without_comments(line)
        if in_code := _REALTIME.search(code):
            found.append(Problem(number, _effect(code, in_code[0]), in_comment=False))
        else:
            effect = f"{_effect(line, anywhere[0])} in a comment"
            found.append(Problem(number, effect, in_comment=True))
    return found


def _effect(line: bytes, byte: bytes) -> str:
    """Return in words what a byte of this line would do, if it is sent."""
    if byte in _EFFECTS:
        return _EFFECTS[byte]
    # Another byte from 0x80 on, which is a part of a character in UTF-8 or Latin-1.
    sign = next((sign for sign in text(line) if not sign.isascii()), "")
    if sign and sign in _DASHES:
        return f"{sign!r} is no minus sign: write -"
    return f"{sign!r} holds bytes that are real-time commands"


def _plain(part: bytes) -> bytes:
    """Return a comment in printable ASCII, with accents removed, and without ! ~ ?."""
    letters = unicodedata.normalize("NFKD", text(part).translate(_HARMLESS))
    return bytes(byte for byte in letters.encode("ascii", "ignore") if byte >= 0x20)


def is_answer(line: str) -> bool:
    """Return whether a line from Grbl is the answer to a line."""
    return line == "ok" or line.startswith("error:")


def is_welcome(line: str) -> bool:
    """Return whether a line is the welcome of a Grbl or a grblHAL."""
    return line.startswith("Grbl")
