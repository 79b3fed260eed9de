"""Images: the whole content of a board's flash, as one file to drag onto it.

Imports `boardfile` for chips, `compiling` for the files of a board, `device` for the list of a
deployment, and `run` to check settings.
"""
