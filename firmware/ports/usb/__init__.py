"""The USB of a Pico."""
