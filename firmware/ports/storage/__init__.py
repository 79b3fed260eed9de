"""Storage that survives power-off: settings, programs, the user's modules; in flash, on a card."""
