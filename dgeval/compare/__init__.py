"""Comparison of two runs of the same trials: the first difference, its effect, better or worse."""
