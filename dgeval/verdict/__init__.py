"""What became of a trial and why. So far only what the log says outright."""
