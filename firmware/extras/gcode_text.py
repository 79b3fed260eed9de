"""G-code as handlers of custom.py write it: made ready for the interpreter, or cut into words."""


def clean(line: str) -> bytearray:
    """As lines come from the reader: upper case, no spaces, no comments; a 0 follows."""
    return bytearray(code_of(line).encode() + b"\0")


def code_of(line: str) -> str:
    """The same as text."""
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
    """Letters and numbers. ValueError where there is none."""
    return [(letter, float(number)) for letter, number in as_written(text)]


def as_written(text: str) -> "list[tuple[str, str]]":
    """Letters and what stands behind each, up to the next."""
    found = []
    start = 0
    for end in range(1, len(text) + 1):
        if end == len(text) or "A" <= text[end] <= "Z":
            found.append((text[start], text[start + 1 : end]))
            start = end
    return found
