"""The bytes that may go to a Grbl: what its protocol has, and nothing else.

Three Ctrl-C in a row are the way to MicroPython's prompt on a board of ours, past every interlock
(firmware/ports/escape.py); other firmware has other ones. Whatever carries bytes of others to a
machine passes them through here.
"""

# Lines of text with their ends, Ctrl-X, and all from 0x80 on, which act at once.
PERMITTED = bytes((*b"\t\n\r\x18", *range(0x20, 0x7F), *range(0x80, 0x100)))
_OTHERS = bytes(set(range(0x100)) - set(PERMITTED))


def permitted(data: bytes) -> bytes:
    """Those of the bytes that are of Grbl's protocol."""
    return data.translate(None, _OTHERS)
