"""How deep a preshaped hand would lie in the model cloud.

It finds grasps that a robot could reach only through the object. Ours, beyond the paper, whose
evaluator does not take the finger joints.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dgeval.geometry import Array, invert
from dgeval.robots.hand import KnownHand

# m; spacing of the points added below observed points: across, and downwards
COLUMN, LEVEL = 0.009, 0.014


def overlap(points: Array, T_cloud_palm: Array, joints: Array, hand: KnownHand) -> Array:
    """Depth (n,) m of the deepest cloud point, of points (m, 3) m, inside the hand; 0 if none.

    For each palm pose T_cloud_palm (n, 4, 4) with drive positions (n, k) rad.
    """
    T_palm_hand = invert(hand.T_hand_palm)
    solids = hand.solids(joints)
    centres = np.array(
        [T_palm_hand[:3, :3] @ centre + T_palm_hand[:3, 3] for _, centre in solids.boxes]
    )
    halves = np.array([half for half, _ in solids.boxes])
    R_palm_hand = T_palm_hand[:3, :3].copy()
    return np.asarray(
        _deepest(points, T_cloud_palm, solids.axes, solids.radius, R_palm_hand, centres, halves)
    )


def depth_below(
    normal: Array, offset: float, T_cloud_palm: Array, joints: Array, hand: KnownHand
) -> Array:
    """How far (n,) m the hand at each palm pose (n, 4, 4) reaches below the plane normal . p =
    offset.

    Negative: the hand is above the plane.
    """
    T_palm_hand = invert(hand.T_hand_palm)
    solids = hand.solids(joints)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    corners = np.concatenate(
        [np.array(centre) + signs * np.array(half) for half, centre in solids.boxes]
    )
    corners = corners @ T_palm_hand[:3, :3].T + T_palm_hand[:3, 3]
    along = T_cloud_palm[:, :3, :3].transpose(0, 2, 1) @ normal  # the normal in each palm's frame
    at = T_cloud_palm[:, :3, 3] @ normal - offset
    lowest = (along @ corners.T).min(axis=1)
    if solids.axes.shape[1]:
        ends = np.einsum("nkec,nc->nke", solids.axes, along)
        lowest = np.minimum(ends.reshape(len(joints), -1).min(axis=1) - solids.radius, lowest)
    return np.asarray(-(lowest + at))


def standing_points(points: Array, normal: Array, offset: float) -> Array:
    """Points (k, 3) m below each of `points` (m, 3) m, down to the plane normal . p = offset.

    They fill what stands on the plane. A camera sees tops and near sides only; without these points
    a hand in an object's far side would be called free.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    height = points @ normal - offset
    cells = np.floor(points @ across.T / COLUMN).astype(np.int64)
    at, which = np.unique(cells, axis=0, return_inverse=True)
    top = np.full(len(at), -np.inf)
    np.maximum.at(top, which.ravel(), height)
    levels = np.arange(LEVEL / 2, max(float(top.max()), LEVEL), LEVEL)
    cell, level = np.nonzero(levels[None] < top[:, None] - COLUMN)
    return np.asarray(
        (at[cell] + 0.5) * COLUMN @ across + (levels[level] + offset)[:, None] * normal
    )


@njit(cache=True)
def _deepest(points, T, axes, radius, R_palm_hand, centres, halves):
    out = np.zeros(len(T))
    p = np.empty(3)
    local = np.empty(3)
    for i in range(len(T)):
        for m in range(len(points)):
            for c in range(3):  # the point in the palm's frame
                p[c] = 0.0
                for r in range(3):
                    p[c] += T[i, r, c] * (points[m, r] - T[i, r, 3])
            for k in range(axes.shape[1]):
                along = length2 = 0.0
                for c in range(3):
                    edge = axes[i, k, 1, c] - axes[i, k, 0, c]
                    along += (p[c] - axes[i, k, 0, c]) * edge
                    length2 += edge * edge
                share = min(max(along / length2, 0.0), 1.0)
                distance2 = 0.0
                for c in range(3):
                    at = axes[i, k, 0, c] + share * (axes[i, k, 1, c] - axes[i, k, 0, c])
                    distance2 += (p[c] - at) ** 2
                out[i] = max(out[i], radius - np.sqrt(distance2))
            for k in range(len(halves)):
                depth = 1.0
                for c in range(3):  # the boxes are aligned with the hand's axes
                    local[c] = 0.0
                    for r in range(3):
                        local[c] += R_palm_hand[r, c] * (p[r] - centres[k, r])
                    depth = min(depth, halves[k, c] - abs(local[c]))
                out[i] = max(out[i], depth)
    return out
