"""Faults: an exception in words that a sender takes for what they are."""

import io
import sys

from micropython import const

from base.text import text_of

_LONGEST = const(120)
# What senders look for, and what is said instead.
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
    """The whole traceback, a text per line."""
    out = io.BytesIO()  # names in a damaged source are no text
    sys.print_exception(fault, out)
    return [text_of(line) for line in out.getvalue().strip().split(b"\n")]


def sanitize(text: str) -> str:
    """The text without what senders take for an answer ("ok", "error") or for a message's end."""
    clean = bytearray()
    for byte in text[:_LONGEST].encode("utf-8", "surrogatepass"):
        if byte & 0xC0 != 0x80:  # a letter has one that is not so, its first
            clean.append(byte if 32 <= byte < 127 and byte not in b"[]" else 32)
    text = text_of(clean)
    for word, told in _LAST_LINES:
        if word in text:
            text = text.replace(word, told)
    return text
