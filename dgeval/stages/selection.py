"""The dynamic grasp metric (paper equations 3 to 5, readings PAPERS A1 and A2) and the choice by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dgeval.config import SelectionConfig
from dgeval.geometry import Array, rotation_angle, rotation_vector


@dataclass(frozen=True, slots=True)
class Grasp:
    """A candidate: T_base_palm (4, 4) and its predicted success s_G, None where nobody scored it."""

    T_base_palm: Array
    score: float | None


def grasp_metric(grasp: Grasp, T_base_palm: Array, config: SelectionConfig) -> float:
    """m_0 + m_1 of one grasp for the robot's palm pose: score less the weighted distance in position and rotation."""
    d_t = float(np.linalg.norm(grasp.T_base_palm[:3, 3] - T_base_palm[:3, 3]))
    if config.rotation_vector_difference:
        d_r = float(np.linalg.norm(rotation_vector(grasp.T_base_palm[:3, :3]) - rotation_vector(T_base_palm[:3, :3])))
    else:
        d_r = rotation_angle(T_base_palm[:3, :3].T @ grasp.T_base_palm[:3, :3])
    score = grasp.score if grasp.score is not None else 0.0
    if config.literal_eq5:
        return config.c_m_s * score - config.c_m_t * d_t - config.c_m_r * d_r
    return config.c_m_s * score - abs(config.c_m_t) * d_t - abs(config.c_m_r) * d_r


def select(grasps: Sequence[Grasp], T_base_palm: Array, config: SelectionConfig) -> tuple[Grasp, float] | None:
    """The grasp with the greatest metric, the first among equals; None of none. A NaN score never wins."""
    best: tuple[Grasp, float] | None = None
    for grasp in grasps:
        value = grasp_metric(grasp, T_base_palm, config)
        if value == value and (best is None or value > best[1]):
            best = (grasp, value)
    return best
