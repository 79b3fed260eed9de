"""The texts of the page in other languages: tables by English text, as data for the page.

A table is a file beside the page, texts_CODE.json. Its first entry, "", is the language's name.
The page has no English texts a second time: it finds a text by a number of six hex digits.
"""

import json
from collections.abc import Mapping
from pathlib import Path

_PREFIX = "texts_"
_MULTIPLIER = 31
_MASK = 0xFFFFFF
NAME = ""  # the entry with the language's name


def tables(folder: Path) -> dict[str, dict[str, str]]:
    """Return the tables by code of the language. OSError or ValueError if one cannot be read."""
    files = sorted(folder.glob(f"{_PREFIX}*.json"))
    return {
        file.stem.removeprefix(_PREFIX): json.loads(file.read_text(encoding="utf-8"))
        for file in files
    }


def number(text: str) -> str:
    """Return the number by which the page finds a text; texts.js computes it, too."""
    found = 0
    for sign in text:
        found = (found * _MULTIPLIER + ord(sign)) & _MASK
    return f"{found:06x}"


def data(languages: Mapping[str, Mapping[str, str]]) -> dict[str, object]:
    """Return the page's data: the numbers of all texts as one string, and each language's name and
    texts in that order; "" for a missing one. ValueError if two texts have one number."""
    texts = list(dict.fromkeys(text for table in languages.values() for text in table if text))
    found: dict[str, str] = {}
    for text in texts:
        if (other := found.setdefault(number(text), text)) != text:
            raise ValueError(f"change a word, two texts have one number: {other!r}, {text!r}")
    return {
        "numbers": "".join(found),
        "languages": {
            code: [table.get(text, "") for text in (NAME, *texts)]
            for code, table in languages.items()
        },
    }
