"""Pulse engine of RP2040 and RP2350: PIO state machines."""
