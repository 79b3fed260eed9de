"""`python -m ugrbl.cli` is `ugrbl`."""

from .app import ugrbl

ugrbl()
