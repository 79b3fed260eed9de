"""The web page's other end: a server between browsers and one board, or the simulator.

Nothing here knows what a job is: bytes go both ways, and what a program will do is told before.

Imports `grbl`, `run` for the simulator, of `sim` its switches, `draw` for a program's path,
`compiling` for the page as one file, and `device` for the board's port.
"""
