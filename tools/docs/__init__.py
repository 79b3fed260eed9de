"""The generated parts of the documents, from the firmware's own tables: see __main__.py.

Imports `grbl`, `boardfile` and `replay` for their tables, `run` and `sim` for a picture.
"""
