"""Which parts a board has, how they are put together, and what keeps them running."""
