# mypy: ignore-errors
"""Report facts to the computer."""

import json
import sys


def say(what, **facts):
    """Print a fact as JSON, piece by piece, so that its whole text is never in memory."""
    sys.stdout.write("= " + what + " ")
    json.dump(facts, sys.stdout)
    print()
