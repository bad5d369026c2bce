"""Training data from physics and from a camera model, and the training of the networks that ship with dgeval."""

import dgeval.worlds  # noqa: F401  chooses how MuJoCo draws, before it is first loaded
