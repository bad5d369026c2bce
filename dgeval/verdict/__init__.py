"""What became of a trial and why: outcome, evidence, the twin, the decision, blame."""
