"""The web page's server, between browsers and one board or the simulator.

It passes bytes both ways, shares a job's progress between browsers, and simulates a program
beforehand.

Imports `grbl`, `run` for the simulator, of `sim` its switches, `draw` for a program's path,
`boardfile` for the page as one file, and `device` for the board's port.
"""
