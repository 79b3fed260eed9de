"""Board files: finding, making and checking them.

Imports `grbl`, and from `sim` the names of motors, and the memory in which a board's default
settings are tried.
"""
