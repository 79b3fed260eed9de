"""G-code: from words to checked blocks to calls of control/canon.py."""
