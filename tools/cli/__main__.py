"""Run `ugrbl` by `python -m ugrbl.cli`."""

from .app import ugrbl

ugrbl()
