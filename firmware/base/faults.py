"""Faults: the text of an exception, made safe for senders."""

import io
import sys

from micropython import const

from base.text import text_of

_LONGEST = const(120)  # characters
# Words that senders look for, and their replacements.
_REPLACEMENTS = (
    ("ok", "o-k"),
    ("oK", "o-K"),
    ("Ok", "O-k"),
    ("OK", "O-K"),
    ("Error", "Err"),
    ("error", "Err"),
    ("ERROR", "Err"),
)


def trace(fault: BaseException) -> "list[str]":
    """Return the exception's whole traceback, one text per line."""
    out = io.BytesIO()  # bytes, because names in a damaged source may not decode
    sys.print_exception(fault, out)
    return [text_of(line) for line in out.getvalue().strip().split(b"\n")]


def sanitize(text: str) -> str:
    """Return the text without what senders take for an answer ("ok", "error") or for the end of a
    message (brackets). Only the first 120 characters are kept."""
    clean = bytearray()
    for byte in text[:_LONGEST].encode("utf-8", "surrogatepass"):
        # Only the first byte of a character counts: in UTF-8 the others begin with the bits 10.
        # A bracket, and a character that is not printable ASCII, becomes a space.
        if byte & 0xC0 != 0x80:
            clean.append(byte if 32 <= byte < 127 and byte not in b"[]" else 32)
    text = text_of(clean)
    for word, replacement in _REPLACEMENTS:
        if word in text:
            text = text.replace(word, replacement)
    return text
