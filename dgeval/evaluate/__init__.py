"""Standing evaluations: the papers' experiments in simulation, beside the papers' own tables."""
