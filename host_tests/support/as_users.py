"""The environment of a user's command."""

import os


def as_users(**changes: str) -> "dict[str, str]":
    """Return the environment without conftest.py's variables.

    Kernels are then those of users, compiled if a C compiler exists. The tests' own environment
    would
    hide faults that appear only with them."""
    return {**{name: v for name, v in os.environ.items() if name != "UGRBL_VIPER"}, **changes}
