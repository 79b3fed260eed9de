"""Board files: finding, making and checking them; and the data files that a board gets with one.

Imports `grbl`, and from `sim` the names of motors, and the memory in which a board's default
settings are tried.
"""
