"""The user's own Python on the board, custom.py: its words, its events, and what it may do."""
