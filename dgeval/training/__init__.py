"""Training of the networks that ship with dgeval, on grasps tried in physics and modelled views."""

import dgeval.worlds  # noqa: F401  selects MuJoCo's rendering backend before MuJoCo loads
