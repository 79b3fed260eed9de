"""MicroPython runs this at power-up. It must be a source file, so the rest is elsewhere."""

from boot import power_up

rp2 = None  # MicroPython's start leaves its module here, which takes a kilobyte
machine = power_up.run_machine(power_up.build())  # ends at the prompt, where it can be inspected
