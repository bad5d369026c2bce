"""Two runs of the same trials: where they first differ, what that led to, and whether it is better or worse."""
