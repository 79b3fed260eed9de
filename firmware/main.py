"""What MicroPython runs at power-up. It wants this file as source, so the rest is elsewhere."""

from boot import power_up

rp2 = None  # MicroPython's start leaves its module here, which takes a kilobyte

parts = power_up.build()


class Running:  # a collection of garbage begins with the names of a class being made
    modules = power_up.modules
    machine = power_up.live(parts)


machine = Running.machine  # it has ended at the prompt, where one may look at it
