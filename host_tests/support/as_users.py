"""The environment in which a user's command runs."""

import os


def as_users(**changes: str) -> "dict[str, str]":
    """Without what conftest.py says: the kernels are what users have, compiled where a C compiler
    is. The tests' own way hides what only those do."""
    return {**{name: v for name, v in os.environ.items() if name != "UGRBL_VIPER"}, **changes}
