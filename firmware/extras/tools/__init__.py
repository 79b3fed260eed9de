"""Tools other than the spindle: a laser, a punch."""
