"""The command line `ugrbl`: a module for each command, and their output and questions.

Imports all other folders of tools, and is imported by none. Only this folder writes to a terminal.
"""
