"""Programs and senders at the simulated machine: from a board's name to what its motors did.

Imports grbl, boardfile and sim. CPython only, other than sim.
"""
