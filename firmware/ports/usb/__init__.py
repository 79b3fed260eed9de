"""A Pico's own USB."""
