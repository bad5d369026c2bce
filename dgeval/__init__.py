"""dgeval: why a dynamic grasp failed, from the log alone."""

__version__ = "0.1.0"
