"""The second pass over a log, with the future allowed: path, surface, moments."""
