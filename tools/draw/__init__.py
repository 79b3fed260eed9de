"""What a job does, as a page or a picture, and how two of them differ.

Imports `grbl`, `boardfile`, `run`, whose programs it watches, and of `sim` a type.
"""
