"""The bytes that may be sent to a Grbl: only those of its protocol.

Three Ctrl-C in a row open MicroPython's prompt on a board of ours, past every interlock
(firmware/ports/escape.py); other firmware has other such bytes. Code that passes bytes of others
to a machine filters them here.
"""

# Text with its line ends, Ctrl-X, and all from 0x80 on, which act at once.
PERMITTED = bytes((*b"\t\n\r\x18", *range(0x20, 0x7F), *range(0x80, 0x100)))
_OTHERS = bytes(set(range(0x100)) - set(PERMITTED))


def permitted(data: bytes) -> bytes:
    """Return only those bytes that belong to Grbl's protocol."""
    return data.translate(None, _OTHERS)
