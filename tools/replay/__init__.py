"""Recordings of real Grbl: replayed on our firmware, compared, judged.

Imports `boardfile` and `compiling`. The replaying is done by sim/replay_main.py, in separate
processes.
"""
