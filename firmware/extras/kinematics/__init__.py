"""Ways from axes to motors, besides one motor for each axis."""
