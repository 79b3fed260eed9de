"""Motors: two on an axis, backlash, drivers, jerk limit, homing order, shared limits."""
