"""G-code: words to checked blocks to what control may be asked for."""
