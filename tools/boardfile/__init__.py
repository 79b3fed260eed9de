"""Board files: how one is found, made of answers, and judged from its data.

Imports grbl, and of sim the place where a machine keeps its settings.
"""
