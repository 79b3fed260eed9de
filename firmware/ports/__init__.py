"""Code that all chips share: pins other than STEP and DIR, links, flash, the supervisor."""
