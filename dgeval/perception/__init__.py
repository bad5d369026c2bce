"""From frames to the object's pose and velocity: one file per stage. No I/O, no global state."""
