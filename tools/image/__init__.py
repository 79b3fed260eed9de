"""Images: all that is to be in a board's flash, as one file to drag onto it.

Imports `boardfile` for chips, `compiling` for what belongs on a board, `device` for what a
deployment leaves there, and `run` for settings that the machine would take.
"""
