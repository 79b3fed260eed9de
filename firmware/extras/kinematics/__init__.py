"""Kinematics other than one motor for each axis."""
