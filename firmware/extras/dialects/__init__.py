"""The reports of other controllers, and their words."""
