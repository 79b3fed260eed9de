"""Tools besides the spindle: a laser, a punch."""
