"""What a Grbl says and reads, as text: programs, settings, and its numbers in words.

Imports nothing of the other rooms; the words come out of the firmware's own tables.
"""
