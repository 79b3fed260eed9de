"""What MicroPython runs at power-up. It wants this file as source, so the rest is elsewhere."""

import power_up

machine = power_up.live(power_up.build())  # ends at the prompt, where one may look at it
