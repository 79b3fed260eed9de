"""Dialects: the reports of other controllers, and their words."""
