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
    """Encode a number with seven bits per byte, highest first."""
    made = [value & 127]
    while value := value >> 7:
        made.append(value & 127 | 128)
    return bytes(reversed(made))


class _Reader:
    def __init__(self, compiled: bytes) -> None:
        self._compiled = compiled
        self.at = _HEAD

    def pass_tables(self) -> None:
        """Read over the tables of names and constants."""
        names, constants = self._number(), self._number()
        for _ in range(names):
            length = self._number()
            if not length & _IS_ROM:
                self._take((length >> 1) + 1)
        for _ in range(constants):
            self._pass_constant()

    def function(self, rewrite: Rewrite) -> Iterator[bytes]:
        """Yield a function, rewritten, and the functions within it. The first is the module's."""
        head = self._number()
        kind = head & _KINDS
        code = self._take(head >> _KIND_BITS)
        behind = b""
        if kind == _NATIVE:
            prelude = self._number()
            code, behind = _native(code, prelude, rewrite)
        elif kind == _VIPER:
            flags = self._number()
            if flags & _VIPER_SECTIONS:
                raise ValueError("native code that is linked from elsewhere")
            code, behind = rewrite(code), number(flags)
        elif kind != _BYTECODE:
            raise ValueError("inline assembler")
        yield number(len(code) << _KIND_BITS | head & (_KINDS | _HAS_CHILDREN))
        yield code + behind
        if head & _HAS_CHILDREN:
            children = self._number()
            yield number(children)
            for _ in range(children):
                yield from self.function(rewrite)

    def _pass_constant(self) -> None:
        kind = self._take(1)[0]
        if kind == _TUPLE:
            for _ in range(self._number()):
                self._pass_constant()
        elif kind > _WITHOUT_TEXT:
            self._take(self._number() + (kind in (_STR, _BYTES)))

    def _number(self) -> int:
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
    """Return code with its prelude, and the encoded position where the prelude begins."""
    if not (code[prelude] & 128 and code[prelude + 1] & _GENERATOR):
        made = rewrite(code[:prelude])
        code, prelude = made + code[prelude:], len(made)
    return code, number(prelude)
