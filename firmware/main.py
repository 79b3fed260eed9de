"""What MicroPython runs at power-up. It wants this file as source, so the rest is elsewhere."""

from boot import power_up

rp2 = None  # MicroPython's start leaves its module here, which takes a kilobyte
machine = power_up.run_machine(power_up.build())  # it ends at the prompt, where one may look at it
