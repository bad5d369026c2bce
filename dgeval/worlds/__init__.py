"""MuJoCo worlds of tables: scene, objects, textures, and a hand at an object; for simulator, twin and grasp sampler."""

import dgeval.robots  # noqa: F401  (it chooses how images are drawn before mujoco is imported)
