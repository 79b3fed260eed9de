"""G-code text of custom.py's handlers: prepare it for the interpreter, or split it into words."""


def clean(line: str) -> bytearray:
    """Return a line as the reader passes it: upper case, no spaces or comments, a 0 after it."""
    return bytearray(code_of(line).encode() + b"\0")


def code_of(line: str) -> str:
    """Return a line's G-code as text: upper case, no spaces, no comments, no block delete (/)."""
    code = ""
    in_comment = False
    for c in line.upper():
        if in_comment:
            in_comment = c != ")"
        elif c == ";":
            break
        elif c == "(":
            in_comment = True
        elif c > " " and c != "/":
            code += c
    return code


def words_of(text: str) -> "list[tuple[str, float]]":
    """Return each letter and its number. text: code_of()'s result. ValueError if a letter has no
    number."""
    return [(letter, float(number)) for letter, number in letters_and_texts(text)]


def letters_and_texts(text: str) -> "list[tuple[str, str]]":
    """Return each letter and the text after it, up to the next letter. G1X2: (G, 1), (X, 2)."""
    words = []
    start = 0  # index of a word's letter
    for end in range(1, len(text) + 1):
        if end == len(text) or "A" <= text[end] <= "Z":
            words.append((text[start], text[start + 1 : end]))
            start = end  # the next word's letter
    return words
