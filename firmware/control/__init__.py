"""What the machine does: run states, spindle, coolant, homing, probing, what moves it."""
