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
    start = at = 0
    depths: list[int] = []  # open braces in the value of each open template
    while at < len(script):
        sign = script[at]
        end, kind = _literal_or_comment(script, start, at, depths)
        if not end:
            if depths:
                depths[-1] += (sign == "{") - (sign == "}")
            at += 1
            continue
        if at > start:
            yield CODE, script[start:at]
        yield kind, script[at:end]
        if sign == "}":
            depths.pop()
        if sign in "`}" and script[end - 1] == "{":
            depths.append(0)
        start = at = end
    if at > start:
        yield CODE, script[start:]


def _literal_or_comment(script: str, start: int, at: int, depths: list[int]) -> tuple[int, str]:
    """Return the end of what begins here, and its kind; 0 if it is code."""
    sign = script[at]
    if script.startswith("//", at):
        return script.index("\n", at), COMMENT
    if script.startswith("/*", at):
        return script.index("*/", at) + 2, COMMENT
    if sign in "\"'":
        return _end(script, at + 1, sign), LITERAL
    if sign == "`" or (sign == "}" and depths and not depths[-1]):
        return _template_end(script, at + 1), LITERAL
    before = script[start:at].rstrip()
    if (
        sign == "/"
        and before
        and (before[-1] in _BEFORE_REGEX or _WORD_BEFORE_REGEX.search(before))
    ):
        return _regex_end(script, at + 1), LITERAL
    return 0, CODE


def _end(script: str, at: int, quote: str) -> int:
    while script[at] != quote:
        at += 1 + (script[at] == "\\")
    return at + 1


def _template_end(script: str, at: int) -> int:
    while script[at] != "`":
        if script.startswith("${", at):
            return at + 2
        at += 1 + (script[at] == "\\")
    return at + 1


def _regex_end(script: str, at: int) -> int:
    in_class = False
    while in_class or script[at] != "/":
        in_class = (in_class or script[at] == "[") and script[at] != "]"
        at += 1 + (script[at] == "\\")
    return at + 1


def lean(script: str) -> str:
    """Return the script without comments, indentation, empty lines, and spaces around signs."""
    kept = "\n"
    for kind, text in pieces(script):
        if kind == CODE:
            code = _AROUND_SIGNS.sub(r"\1", _LINE_END.sub("\n", text))
            kept += code.lstrip() if kept[-1] == "\n" else code
        elif kind == LITERAL:
            kept += text
    return kept[1:]
