"""Recordings of real Grbl beside what our firmware answers: replayed, compared, judged.

Imports `boardfile` and `compiling`. The replaying is done by sim/replay_main.py, in processes of
its own.
"""
