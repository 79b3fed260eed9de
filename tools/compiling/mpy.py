"""Compiled modules in MicroPython's format 6: rewrite the native code of their functions."""

from collections.abc import Callable, Iterator

# Gets the code of a native function, returns the new code.
Rewrite = Callable[[bytes], bytes]

_HEAD = 4  # magic byte, version, flags, bits of a small integer
# The kind of a function, in the lowest bits of its length.
_KINDS = 3
_BYTECODE = 0
_NATIVE = 1  # a prelude after the code describes the arguments
_VIPER = 2
_HAS_CHILDREN = 4
_KIND_BITS = 3
_VIPER_SECTIONS = 0x70  # flags of code that is linked from elsewhere: it has data sections too
_GENERATOR = 0x40  # in a prelude's second byte, if it has one
_IS_ROM = 1  # in the length of a name: it is in MicroPython's own table
_TUPLE = 10  # kinds of constants
_STR, _BYTES = 5, 6
_WITHOUT_TEXT = 4  # kinds of constants up to this one, such as None and True, have no text


def rewritten(compiled: bytes, rewrite: Rewrite) -> bytes:
    """Return the module with the code of each function replaced by rewrite(code)."""
    reader = _Reader(compiled)
    reader.pass_tables()
    return compiled[: reader.at] + b"".join(reader.function(rewrite))


def number(value: int) -> bytes:
    """Encode a number with seven bits per byte, highest first; all bytes but the last have bit 7
    set."""
    encoded = [value & 127]  # from the last byte to the first
    while value := value >> 7:
        encoded.append(value & 127 | 128)
    return bytes(reversed(encoded))


class _Reader:
    """Reads a compiled module from its position `at` on."""

    def __init__(self, compiled: bytes) -> None:
        self._compiled = compiled
        self.at = _HEAD

    def pass_tables(self) -> None:
        """Read over the tables of names and constants."""
        names, constants = self._number(), self._number()
        for _ in range(names):
            length = self._number()
            if not length & _IS_ROM:
                self._take((length >> 1) + 1)  # its text, and a zero byte
        for _ in range(constants):
            self._pass_constant()

    def function(self, rewrite: Rewrite) -> Iterator[bytes]:
        """Yield the bytes of a function, with its code rewritten, and of the functions within it.
        The outermost one is the module's own code. Bytecode stays as it is."""
        head = self._number()
        kind = head & _KINDS
        code = self._take(head >> _KIND_BITS)
        trailer = b""  # what follows the code
        if kind == _NATIVE:
            prelude = self._number()  # its position in the code
            code, trailer = _native(code, prelude, rewrite)
        elif kind == _VIPER:
            flags = self._number()
            if flags & _VIPER_SECTIONS:
                raise ValueError("native code that links to other code is not supported")
            code, trailer = rewrite(code), number(flags)
        elif kind != _BYTECODE:
            raise ValueError("inline assembler")
        yield number(len(code) << _KIND_BITS | head & (_KINDS | _HAS_CHILDREN))
        yield code + trailer
        if head & _HAS_CHILDREN:
            children = self._number()
            yield number(children)
            for _ in range(children):
                yield from self.function(rewrite)

    def _pass_constant(self) -> None:
        """Read over a constant: a tuple of constants, or a kind that may have a text."""
        kind = self._take(1)[0]
        if kind == _TUPLE:
            for _ in range(self._number()):
                self._pass_constant()
        elif kind > _WITHOUT_TEXT:
            has_zero_byte = kind in (_STR, _BYTES)  # after the text
            self._take(self._number() + has_zero_byte)

    def _number(self) -> int:
        """Read a number that number() encodes."""
        value = 0
        while True:
            byte = self._take(1)[0]
            value = value << 7 | byte & 127
            if byte < 128:
                return value

    def _take(self, count: int) -> bytes:
        self.at += count
        return self._compiled[self.at - count : self.at]


def _native(code: bytes, prelude: int, rewrite: Rewrite) -> "tuple[bytes, bytes]":
    """Return the code, rewritten, with its prelude, and the encoded position of the prelude. The
    code of a generator is not rewritten."""
    has_second_byte = code[prelude] & 128
    if not (has_second_byte and code[prelude + 1] & _GENERATOR):
        rewritten_code = rewrite(code[:prelude])
        code, prelude = rewritten_code + code[prelude:], len(rewritten_code)
    return code, number(prelude)
