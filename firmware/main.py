"""What MicroPython runs at power-up. It wants this file as source, so the rest is elsewhere."""

import sys

from boot import power_up

rp2 = None  # MicroPython's start leaves its module here, which takes a kilobyte

parts = power_up.build()


# A collection of garbage marks first what is named in a class being made. Were it to come from one
# module to another, more would wait to be marked than the 64 that it keeps in mind, and it would
# search all of memory again: 21 ms instead of 11.
class Running:
    modules = tuple(sys.modules.values())
    machine = power_up.live(parts)


machine = Running.machine  # it has ended at the prompt, where one may look at it
