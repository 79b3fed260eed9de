"""The generated parts of the documents, out of the firmware's own tables: see __main__.py.

Imports `grbl`, `boardfile` and `replay`, whose tables are shown.
"""
