"""MicroPython's deflate, as far as it is needed, by zlib."""

import io
import zlib

RAW = 1


class DeflateIO:
    """Decompresses a stream of raw deflate; OSError if it is damaged."""

    def __init__(self, stream: io.BytesIO, packing: int, window_log2: int) -> None:
        assert packing == RAW
        unpacking = zlib.decompressobj(-window_log2)
        try:
            self._left = unpacking.decompress(stream.read())
        except zlib.error as fault:
            raise OSError(22) from fault  # EINVAL

    def readinto(self, buf: bytearray) -> int:
        """Fill the buffer; returns the number of bytes."""
        count = min(len(buf), len(self._left))
        buf[:count] = self._left[:count]
        self._left = self._left[count:]
        return count
