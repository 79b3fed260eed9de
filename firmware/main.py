"""What MicroPython runs at power-up. It wants this file as source, so the rest is elsewhere."""

import power_up

machine = power_up.main()  # comes to an end for the prompt, where one may look at it
