"""Recordings of real Grbl beside what our firmware answers: replayed, compared, judged.

Imports boardfile; sim replays, in processes of its own.
"""
