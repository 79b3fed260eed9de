"""Plain English: words of a dialect that this project once had stay rare.

Counted in comments, docstrings, messages, the documents, and names of tests, per 10,000 words of
each folder. In November 2026 there were 28 of "behind", 18 of "told" and 50 of "what is"; Klipper
has 0.4, 0.4 and 0. A limit leaves room for the plain use: a pin behind a shift register, "Return
what is wrong with a board".
"""

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[2]
_FOLDERS = ("firmware", "tools", "host_tests", "boards", "docs")
# A pattern, and how often it may stand in 10,000 words.
_DIALECT = {
    r"behind": 2,
    r"told|tells?|telling": 4,
    r"beside|besides": 2,
    r"whoever|who has|who is": 2,
    r"he|his|him": 1,
    r"what (?:is|are|has|have|was)": 10,
    r"in vain|nothing but|but for": 1,
    r"lets? go of|sees? to|seen to|takes? in": 1,
    r"seldom|thereof|therein": 1,
}


def _text_of(file: Path) -> Iterator[str]:
    """Yield what somebody reads in a file that is no code.

    Of a program: comments, texts of several words, and names of tests.
    """
    source = file.read_text(encoding="utf-8")
    if file.suffix == ".md":
        yield source
        return
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.value
        elif isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            yield node.name.replace("_", " ")


def _shares(texts: "list[str]") -> "dict[str, float]":
    """Return how often each pattern of _DIALECT occurs in 10,000 words of these texts."""
    words = sum(len(text.split()) for text in texts)
    counts = Counter(
        {
            pattern: sum(len(re.findall(rf"\b(?:{pattern})\b", t, re.IGNORECASE)) for t in texts)
            for pattern in _DIALECT
        }
    )
    return {pattern: 10_000 * count / words for pattern, count in counts.items()}


@pytest.mark.parametrize("folder", _FOLDERS)
def test_words_of_the_dialect_are_rare(folder: str) -> None:
    files = [file for file in (_ROOT / folder).rglob("*") if file.suffix in (".py", ".md")]
    shares = _shares([text for file in files if file != Path(__file__) for text in _text_of(file)])
    assert {word: n for word, n in shares.items() if n > _DIALECT[word]} == {}


def test_a_word_of_the_dialect_is_counted() -> None:
    assert _shares(["It comes behind", "the other, which is told of it"])[r"behind"] == 1000
