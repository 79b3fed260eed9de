"""The lines of a program, cut from its bytes on demand, because a list of all lines takes four
times as much memory as the file."""

import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import overload

# A doubled CR before the LF, from a broken conversion, ends one line and not two.
LINE_END = re.compile(rb"\n|\r(?:\r*\n)?")
_LONE_CR = re.compile(rb"\r(?!\n)")
_PIECE = 1000  # lines cut at once


def split_lines(data: bytes) -> list[bytes]:
    """Return the lines of a program without their ends, all at once."""
    lines = LINE_END.split(data)
    if not lines[-1]:
        lines.pop()
    return lines


def with_line_feeds(data: bytes) -> bytes:
    """Return a program in which every line ends with LF, as boards read their own files."""
    return LINE_END.sub(b"\n", data) if _LONE_CR.search(data) else data


class Lines(Sequence[bytes]):
    """A sequence equal to split_lines(), which takes only a few bytes per line besides the
    data."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        line_ends = (match.end() for match in LINE_END.finditer(data))
        # Where each line begins in the data, and where the last one ends. Four bytes each.
        self._starts = array("Q" if len(data) >> 32 else "I", chain((0,), line_ends))
        if self._starts[-1] < len(data):  # the last line has no line end
            self._starts.append(len(data))
        self._numbers = range(len(self._starts) - 1)  # of the lines in this sequence, from 0

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> "Lines": ...
    def __getitem__(self, index: "int | slice") -> "bytes | Lines":
        """Return a line without its end; for a slice, Lines of the same data."""
        if isinstance(index, slice):
            part = Lines(b"")
            part._data, part._starts = self._data, self._starts
            part._numbers = self._numbers[index]
            return part
        number = self._numbers[index]
        return self._data[self._starts[number] : self._starts[number + 1]].rstrip(b"\r\n")

    def __iter__(self) -> Iterator[bytes]:
        """Yield the lines; many at once are split faster than one by one."""
        numbers = self._numbers
        if numbers.step != 1:  # a slice with a step: lines that are not in a row
            yield from map(self.__getitem__, range(len(self)))
            return
        for first in range(numbers.start, numbers.stop, _PIECE):
            last = min(first + _PIECE, numbers.stop)
            yield from split_lines(self._data[self._starts[first] : self._starts[last]])


class Changed(Sequence[bytes]):
    """Lines that a function changes on demand."""

    def __init__(self, lines: Sequence[bytes], change: Callable[[bytes], bytes]) -> None:
        self._lines = lines
        self._change = change

    def __len__(self) -> int:
        return len(self._lines)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> "Changed": ...
    def __getitem__(self, index: "int | slice") -> "bytes | Changed":
        if isinstance(index, slice):
            return Changed(self._lines[index], self._change)
        return self._change(self._lines[index])

    def __iter__(self) -> Iterator[bytes]:
        return map(self._change, self._lines)
