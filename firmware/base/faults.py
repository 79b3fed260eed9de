"""Faults: an exception in words that a sender takes for what they are."""

import io
import sys

from micropython import const

_LONGEST = const(120)


def trace(fault: BaseException) -> "list[str]":
    """The whole traceback, a text per line."""
    out = io.StringIO()
    sys.print_exception(fault, out)
    return out.getvalue().strip().split("\n")


def harmless(text: str) -> str:
    """The text without what senders take for an answer ("ok", "error") or for a message's end."""
    clean = ""
    for c in text[:_LONGEST]:
        if clean[-1:] in ("o", "O") and c in ("k", "K"):
            clean += "-"
        clean += c if " " <= c <= "~" and c not in "[]" else " "
    for word in ("Error", "error", "ERROR"):
        clean = clean.replace(word, "Err")
    return clean
