"""What MicroPython runs at power-up. It wants this file as source, so the rest is elsewhere."""

import sys

from boot import power_up

rp2 = None  # MicroPython's start leaves its module here, which takes a kilobyte

parts = power_up.build()


# A collection of garbage marks first what is named in a class being made. Were it to come from one
# module to another, more would wait to be marked than the 64 that it keeps in mind, and it would
# search all of memory again: 21 ms instead of 11. The last is looked into first, so those with the
# most names come when nothing else waits.
class Running:
    modules = tuple(sorted(sys.modules.values(), key=lambda module: -len(module.__dict__)))
    machine = power_up.live(parts)


machine = Running.machine  # it has ended at the prompt, where one may look at it
