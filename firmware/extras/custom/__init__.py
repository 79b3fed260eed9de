"""Custom code: the user's own Python on the board (custom.py), its words, events and API."""
