"""Programs that run on the board, sent to its prompt and stored nowhere: see program.py.

MicroPython receives these files as one program, in the order given in program.py. They measure and
print facts, a line of JSON each; the computer judges them (judge.py). From the compiled firmware
they use only modules, classes, functions and methods, because other names are shortened there.
"""
