"""The machine's behaviour: run states, motor control, spindle, coolant, homing, probing."""
