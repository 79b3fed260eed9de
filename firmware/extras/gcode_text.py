"""G-code text of custom.py's handlers: prepare it for the interpreter, or split it into words."""


def clean(line: str) -> bytearray:
    """Return a line as the reader passes it: upper case, no spaces or comments, a 0 after it."""
    return bytearray(code_of(line).encode() + b"\0")


def code_of(line: str) -> str:
    """Return the same as text, without the 0."""
    code = ""
    within = False
    for c in line.upper():
        if within:
            within = c != ")"
        elif c == ";":
            break
        elif c == "(":
            within = True
        elif c > " " and c != "/":
            code += c
    return code


def words_of(text: str) -> "list[tuple[str, float]]":
    """Return letters and numbers. ValueError if a letter has no number."""
    return [(letter, float(number)) for letter, number in as_written(text)]


def as_written(text: str) -> "list[tuple[str, str]]":
    """Return each letter and the text after it, up to the next letter."""
    found = []
    start = 0
    for end in range(1, len(text) + 1):
        if end == len(text) or "A" <= text[end] <= "Z":
            found.append((text[start], text[start + 1 : end]))
            start = end
    return found
