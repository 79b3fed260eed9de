"""Select the parts of a board, build the machine from them, and keep it running."""
