"""The motion of a job as a page or a picture, and the difference between two jobs.

Imports `grbl`, `boardfile`, `run`, whose programs it traces, and a type from `sim`.
"""
