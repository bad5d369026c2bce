"""The dynamic grasp metric and the order of candidates by it.

See docs/papers.md, "Equations 3 to 5: choice of a grasp".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgeval.config import SelectionConfig
from dgeval.geometry import Array


def grasp_metric(
    T_base_palm: Array, scores: Array, T_base_hand_palm: Array, config: SelectionConfig
) -> Array:
    """m_0 + m_1 (n,) of candidates: score s_G less the weighted distances in position and rotation.

    T_base_palm (n, 4, 4) and scores (n,) of the candidates; T_base_hand_palm (4, 4): the palm's
    pose now.
    """
    R, R_hand = T_base_palm[:, :3, :3], T_base_hand_palm[:3, :3]
    d_t = np.linalg.norm(T_base_palm[:, :3, 3] - T_base_hand_palm[:3, 3], axis=1)
    if config.rotation_vector_difference:
        d_r = np.linalg.norm(
            Rotation.from_matrix(R).as_rotvec() - Rotation.from_matrix(R_hand).as_rotvec(), axis=1
        )
    else:
        d_r = Rotation.from_matrix(R_hand.T @ R).magnitude()
    if config.literal_eq5:
        return np.asarray(config.c_m_s * scores - config.c_m_t * d_t - config.c_m_r * d_r)
    return np.asarray(config.c_m_s * scores - abs(config.c_m_t) * d_t - abs(config.c_m_r) * d_r)


def by_metric(metric: Array, kept: float = 0.0) -> NDArray[np.intp]:
    """Rows of candidates by falling metric (n,); of equal ones the first comes first; NaN left out.

    kept: added to the metric of the last candidate.
    """
    if kept:
        metric = np.append(metric[:-1], metric[-1] + kept)
    order = np.argsort(-metric, kind="stable")
    return np.asarray(order[np.isfinite(metric[order])])
