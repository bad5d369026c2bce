"""MuJoCo models of hand, arm, objects and scene, built from tables; for the simulator and the twin."""

import os
import sys

if sys.platform == "linux":
    # drawing without a display; read when mujoco is first imported, so here. A user's own choice stands.
    os.environ.setdefault("MUJOCO_GL", "egl")
