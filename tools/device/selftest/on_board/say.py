# mypy: ignore-errors
"""How facts are told."""

import json
import sys


def say(what, **facts):
    """A fact, for the computer to judge. Its text is nowhere in memory as a whole."""
    sys.stdout.write("= " + what + " ")
    json.dump(facts, sys.stdout)
    print()
