"""Jobs: programs stored on the board, which run without a computer."""
