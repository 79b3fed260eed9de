"""Text from bytes of a sender, a file or a file's name: no other module decodes them."""


def text_of(data: "bytes | bytearray") -> str:
    """Return bytes as text. A control character becomes a space. A byte that is not ASCII becomes
    `?`, which no line and no name holds, so that the text is refused and not misread."""
    # 31 and below are control characters, 127 and above are not printable ASCII; 63 is `?`.
    return bytes([c if 31 < c < 127 else 32 if c < 32 else 63 for c in data]).decode()
