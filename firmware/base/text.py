"""Text of bytes that a sender, a file or a file's name has brought: nothing else decodes them."""


def text_of(data: "bytes | bytearray") -> str:
    """The text. A control character becomes a space; a byte that is no ASCII becomes `?`, which no
    line and no name holds, so that what has one is refused and not taken for something else."""
    return bytes([c if 31 < c < 127 else 32 if c < 32 else 63 for c in data]).decode()
