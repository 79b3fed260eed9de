"""The tables at the head of a .mpy file, MicroPython's format 6: names, and constants."""

from collections.abc import Iterator

# Mark, version, flags, bits of a small integer.
_HEAD = 4


def _number(compiled: bytes, at: int) -> "tuple[int, int]":
    """A number of seven bits a byte, and where it ends."""
    value = compiled[at] & 127
    while compiled[at] & 128:
        at += 1
        value = value << 7 | compiled[at] & 127
    return value, at + 1


def names(compiled: bytes) -> "Iterator[str]":
    """Those apart that have a fixed place in the ROM."""
    count, at = _number(compiled, _HEAD)
    _, at = _number(compiled, at)
    for _ in range(count):
        kind, at = _number(compiled, at)
        if not kind & 1:
            yield compiled[at : at + (kind >> 1)].decode()
            at += (kind >> 1) + 1


def objects(compiled: bytes) -> int:
    """How many constants are objects: tuples, floats …"""
    _, at = _number(compiled, _HEAD)
    return _number(compiled, at)[0]
