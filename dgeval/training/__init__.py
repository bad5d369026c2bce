"""Training data from physics and from a camera model, and the training of the networks that ship with dgeval."""
