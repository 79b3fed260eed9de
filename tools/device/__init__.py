"""Operations on a machine at a serial port: any Grbl, or a board of ours.

Imports `grbl`, `boardfile` for engines and chips, `compiling` for the files of a board, and `run`
to simulate a program.
"""
