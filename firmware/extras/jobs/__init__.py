"""Programs that live on the board, and run without a computer."""
