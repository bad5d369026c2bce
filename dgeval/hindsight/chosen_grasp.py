"""What the grasp that the replay had chosen is worth by everything that is known afterwards."""

from __future__ import annotations

import numpy as np

from dgeval.config import GraspsConfig
from dgeval.geometry import Array, transform
from dgeval.hindsight.second_pass import Hindsight
from dgeval.planning.control import Choice


def hindsight_score(
    choice: Choice,
    T_base_camera: Array,
    t_ns: int,
    hindsight: Hindsight,
    config: GraspsConfig,
) -> float | None:
    """FFHNet's evaluator on the chosen grasp, 0 to 1, with the final model where hindsight has it.

    At t_ns, on the object's undisturbed path: a choice that was good where the object was believed
    to be, and is not where it was, gets what it deserves. T_base_camera (4, 4): the authors'
    weights see the cloud in its axes. None of a choice without joints: the network didn't make it.
    """
    if choice.joints is None or not len(hindsight.points):
        return None
    from dgeval.planning.grasps import encode_cloud, evaluate, networks_of  # imports torch

    networks = networks_of(config)
    T_view_base = np.eye(4)  # the cloud's axes are the networks', its origin the base's
    T_view_base[:3, :3] = networks.R_cloud_base(T_base_camera)
    points = transform(T_view_base @ hindsight.path.at(t_ns), hindsight.points)
    cloud, pose = encode_cloud(points, networks), T_view_base @ choice.T_base_palm
    return float(evaluate(cloud, networks, pose[None], choice.joints[None])[0])
