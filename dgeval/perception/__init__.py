"""From frames to the object's pose and velocity, one module per stage. No I/O, no global state."""
