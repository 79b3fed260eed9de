# mypy: ignore-errors
"""How facts are told."""

import json


def say(what, **facts):
    """A fact, for the computer to judge."""
    print("= %s %s" % (what, json.dumps(facts)))
