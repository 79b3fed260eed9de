"""The command line `ugrbl`: a module for each command, and what they show and ask.

Imports all other rooms, and nobody imports it. Only here is anything drawn on a terminal.
"""
