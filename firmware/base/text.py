"""Text: bytes of a sender, a file or a file's name as text; exceptions as text, safe for senders.

No other module decodes such bytes.
"""

import io
import sys

from micropython import const

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


def text_of(data: "bytes | bytearray") -> str:
    """Return bytes as text. A control character becomes a space. A byte that is not ASCII becomes
    `?`, which no line and no name holds, so that the text is refused and not misread."""
    # 31 and below are control characters, 127 and above are not printable ASCII; 63 is `?`.
    return bytes([c if 31 < c < 127 else 32 if c < 32 else 63 for c in data]).decode()


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
