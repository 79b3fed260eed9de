"""Grbl's input and output as text: programs, settings, and its numbers in words.

Imports no other folder of tools; the words come from the firmware's own tables.
"""
