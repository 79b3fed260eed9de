"""What a job does, as a page or a picture.

Imports grbl, boardfile and run, which it watches.
"""
