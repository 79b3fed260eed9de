"""The texts of the page in other languages: tables by English text, as data for the page.

A table is a file in the page's folder, texts_CODE.json. Its first entry, "", is the language's
name. The page has no English texts a second time: it finds a text by a number computed from it.
The numbers are sorted and stored as differences, so they take less than two bytes each,
compressed.
"""

import json
from collections.abc import Iterable, Mapping
from itertools import count, pairwise
from pathlib import Path

_PREFIX = "texts_"
_MULTIPLIER = 31  # the first one that is tried
_MASK = 0x1FFFF  # with fewer bits the page is smaller, and the search for a multiplier longer
NAME = ""  # the entry with the language's name


def tables(folder: Path) -> dict[str, dict[str, str]]:
    """Return the tables by code of the language. OSError or ValueError if one cannot be read."""
    files = sorted(folder.glob(f"{_PREFIX}*.json"))
    return {
        file.stem.removeprefix(_PREFIX): json.loads(file.read_text(encoding="utf-8"))
        for file in files
    }


def number(text: str, multiplier: int) -> int:
    """Return the number by which the page finds a text; texts.js computes it, too."""
    result = 0
    for sign in text:
        result = (result * multiplier + ord(sign)) & _MASK
    return result


def multiplier(texts: Iterable[str]) -> int:
    """Return the first multiplier by which no two texts have the same number."""
    texts = set(texts)
    tried = count(_MULTIPLIER, 2)
    return next(
        candidate
        for candidate in tried
        if len({number(x, candidate) for x in texts}) == len(texts)
    )


def data(languages: Mapping[str, Mapping[str, str]]) -> dict[str, object]:
    """Return the page's data: the multiplier; the numbers of all texts, each as the difference to
    the one before; and each language's name and texts in that order, "" for a missing one."""
    texts = {text for table in languages.values() for text in table if text}
    chosen = multiplier(texts)
    by_number = sorted((number(text, chosen), text) for text in texts)
    sorted_numbers = [found for found, _ in by_number]
    sorted_texts = [text for _, text in by_number]
    return {
        "multiplier": chosen,
        "steps": [after - before for before, after in pairwise([0, *sorted_numbers])],
        "languages": {
            code: [table.get(text, "") for text in (NAME, *sorted_texts)]
            for code, table in languages.items()
        },
    }
