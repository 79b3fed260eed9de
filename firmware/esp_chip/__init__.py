"""Pulse engines of the ESP32: I2S into shift registers, RMT on its own pins."""
