"""What is done with a machine at a serial port: any Grbl, or a board of ours.

Imports `grbl`, `boardfile` for engines and chips, `compiling` for what belongs on a board, and
`run` for what a program will do.
"""
