"""Faults: the text of an exception, made safe for senders."""

import io
import sys

from micropython import const

from base.text import text_of

_LONGEST = const(120)
# Words that senders look for, and their replacements.
_LAST_LINES = (
    ("ok", "o-k"),
    ("oK", "o-K"),
    ("Ok", "O-k"),
    ("OK", "O-K"),
    ("Error", "Err"),
    ("error", "Err"),
    ("ERROR", "Err"),
)


def trace(fault: BaseException) -> "list[str]":
    """Return the whole traceback, one text per line."""
    out = io.BytesIO()  # bytes, because names in a damaged source may not decode
    sys.print_exception(fault, out)
    return [text_of(line) for line in out.getvalue().strip().split(b"\n")]


def sanitize(text: str) -> str:
    """Return the text without what senders take for an answer ("ok", "error") or for the end of a
    message (brackets). Only the first 120 characters are kept."""
    clean = bytearray()
    for byte in text[:_LONGEST].encode("utf-8", "surrogatepass"):
        if byte & 0xC0 != 0x80:  # a character's first byte: one place per character
            clean.append(byte if 32 <= byte < 127 and byte not in b"[]" else 32)
    text = text_of(clean)
    for word, told in _LAST_LINES:
        if word in text:
            text = text.replace(word, told)
    return text
