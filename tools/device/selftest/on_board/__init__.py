"""What runs on the board, sent to its prompt and kept nowhere: see program.py.

MicroPython sees these files as one program, in the order of program.PARTS. They measure and say
what they have found, a line of JSON per fact; what it is worth is judged by the computer
(judge.py). Of the compiled firmware they use modules, classes, functions and methods, for other
names are short ones there.
"""
