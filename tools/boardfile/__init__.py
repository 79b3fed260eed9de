"""Board files: where one is, how one is made of answers, what is wrong with one.

Imports `grbl`, and of `sim` what motors are called, and the memory that a board's default settings
are tried in.
"""
