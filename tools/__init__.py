"""ugrbl on the desktop: the simulator and the command line."""

__version__ = "0.1.0"
