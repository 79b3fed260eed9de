"""What a Grbl says and reads, as text: programs, settings, and its numbers in words.

The lowest room: it imports `paths` and the firmware's tables only.
"""
