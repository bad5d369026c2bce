"""Hands and arms: their solids, joints, closing motion and frames; robot descriptions as data."""

import os
import sys

if sys.platform == "linux":
    # Drawing without a display. MuJoCo reads the variable when it is first imported, so it is set
    # here. A value that the user has set stays.
    os.environ.setdefault("MUJOCO_GL", "egl")
