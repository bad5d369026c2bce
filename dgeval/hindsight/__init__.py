"""The second pass over a log, which may use later frames: path, surface, moments."""
