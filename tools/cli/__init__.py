"""The command line `ugrbl`: a module for each command, and what they show and ask.

The highest room: it imports all others, and nobody imports it.
"""
