"""Read the page's scripts: where code, literals and comments begin and end; and make them short.

It knows as much of JavaScript as our scripts use. Line ends stay, because they may end statements.
"""

import re
from collections.abc import Iterator

CODE = "code"
COMMENT = "comment"
# A string or regular expression; or a part of a template: it ends with "${" before a value, and
# begins with "}" after one.
LITERAL = "literal"

_BEFORE_REGEX = "(,=:[!&|?{};+-*%<>~^"
_WORD_BEFORE_REGEX = re.compile(r"\b(return|typeof|case)$")
_AROUND_SIGNS = re.compile(r" *([=*<>?:,;{}()\[\]&|!]+) *")
_LINE_END = re.compile(r"\s*\n\s*")


def pieces(script: str) -> Iterator[tuple[str, str]]:
    """Yield kind and text of each piece; the texts together are the script. IndexError if a
    literal has no end."""
    code_start = index = 0
    # For each template whose value is being read: the braces that are open in the value.
    open_braces: list[int] = []
    while index < len(script):
        sign = script[index]
        end, kind = _literal_or_comment(script, code_start, index, open_braces)
        if kind == CODE:
            if open_braces:
                open_braces[-1] += (sign == "{") - (sign == "}")
            index += 1
            continue
        if index > code_start:
            yield CODE, script[code_start:index]
        yield kind, script[index:end]
        if sign == "}":  # a value has ended
            open_braces.pop()
        if sign in "`}" and script[end - 1] == "{":  # another value begins
            open_braces.append(0)
        code_start = index = end
    if index > code_start:
        yield CODE, script[code_start:]


def _literal_or_comment(
    script: str, code_start: int, index: int, open_braces: list[int]
) -> tuple[int, str]:
    """Return the end and the kind of what begins at an index; (0, CODE) if it is code.

    code_start: where the code before it begins. open_braces: see pieces().
    """
    sign = script[index]
    if script.startswith("//", index):
        return script.index("\n", index), COMMENT
    if script.startswith("/*", index):
        return script.index("*/", index) + 2, COMMENT
    if sign in "\"'":
        return _string_end(script, index + 1, sign), LITERAL
    ends_value = sign == "}" and open_braces and not open_braces[-1]
    if sign == "`" or ends_value:
        return _template_end(script, index + 1), LITERAL
    before = script[code_start:index].rstrip()
    if (
        sign == "/"  # else it is a division
        and before
        and (before[-1] in _BEFORE_REGEX or _WORD_BEFORE_REGEX.search(before))
    ):
        return _regex_end(script, index + 1), LITERAL
    return 0, CODE


# The end of a literal that begins before `index`. A backslash makes the next character literal.


def _string_end(script: str, index: int, quote: str) -> int:
    while script[index] != quote:
        index += 1 + (script[index] == "\\")
    return index + 1


def _template_end(script: str, index: int) -> int:
    """Return the end of a template, or of its part before a value: after "${"."""
    while script[index] != "`":
        if script.startswith("${", index):
            return index + 2
        index += 1 + (script[index] == "\\")  # a backslash and the next character
    return index + 1


def _regex_end(script: str, index: int) -> int:
    """Return the end of a regular expression. In brackets, as in /[/]/, a slash does not end
    it."""
    in_brackets = False
    while in_brackets or script[index] != "/":
        in_brackets = (in_brackets or script[index] == "[") and script[index] != "]"
        index += 1 + (script[index] == "\\")  # a backslash and the next character
    return index + 1


def lean(script: str) -> str:
    """Return the script without comments, indentation, empty lines, and spaces around signs."""
    kept = "\n"  # so that the first line has one before it, too; removed at the end
    for kind, text in pieces(script):
        if kind == CODE:
            code = _AROUND_SIGNS.sub(r"\1", _LINE_END.sub("\n", text))
            kept += code.lstrip() if kept[-1] == "\n" else code  # no empty lines
        elif kind == LITERAL:
            kept += text
    return kept[1:]
