"""What boards have of motors: two on an axis, backlash, drivers, a limit of jerk, their homing."""
