"""MuJoCo worlds of tables: scene, objects, textures, and a hand at an object.

The simulator, the verdict's twin and the grasp samplers share them.
"""

import dgeval.robots  # noqa: F401  (it chooses how images are drawn before mujoco is imported)
