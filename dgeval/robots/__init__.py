"""Hands and arms: solids, joints, how a hand closes, where it holds things; robot descriptions as data."""

import os
import sys

if sys.platform == "linux":
    # drawing without a display; read when mujoco is first imported, so here. A user's own choice stands.
    os.environ.setdefault("MUJOCO_GL", "egl")
