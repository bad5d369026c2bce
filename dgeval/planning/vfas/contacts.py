"""Contact-GraspNet's seeds for VFAS-Grasp: on the target alone, ranked by the arm's joint limits.

Paper (IV-A): the target's points are segmented, Contact-GraspNet is asked for grasps on them, and
those are ranked higher that the arm can do farther away from its joint limits.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from dgeval.determinism import generator
from dgeval.geometry import Array
from dgeval.networks.checkpoints import version_of
from dgeval.networks.contact_graspnet import CENTRES, ContactGraspNet, load_contact_graspnet

# Poses T_base_grasp (n, 4, 4) -> how good each is (n,); -inf for one that can't be done.
Rank = Callable[[Array], Array]
# T_base_grasp (4, 4) -> how far the arm is from its limits there, 0 to 1; None out of reach
Reach = Callable[[Array], float | None]
SCENE_POINTS = 20_000  # most points of the scene, as in Contact-GraspNet's training
CONFIDENT = 0.23  # least score; of the authors' own selection
SAMPLED = 256  # most poses that are ranked
# m: of the cube around the target that the network is shown, as the authors crop it: twice the
# target's extent, within these
LEAST_CUBE, MOST_CUBE = 0.3, 0.6
ON_TARGET = 0.005  # m from a contact to the nearest of the target's points; ours


def contact_graspnet_of(weights: str) -> ContactGraspNet:
    """Contact-GraspNet with a file's weights; "installed": with those of the installed package."""
    return _read(weights, version_of(Path(weights)))


@cache
def _read(weights: str, _: tuple[int, int]) -> ContactGraspNet:
    return load_contact_graspnet(None if weights == "installed" else Path(weights))


def seed_from_contacts(
    cloud: Array,
    target: Array | None,
    network: ContactGraspNet,
    rank: Rank,
    opening: float,
    seed: int,
) -> Array | None:
    """T_base_grasp (4, 4): of Contact-GraspNet's confident grasps on the target the best by rank.

    cloud (n, 3) m, base frame; target (m, 3): those of the target, None where it is not known: then
    any contact counts. opening: m, of the gripper; wider grasps are left out. None where no grasp
    is left, or the cloud has too few points.
    """
    if target is not None and len(target):
        middle = (target.min(axis=0) + target.max(axis=0)) / 2
        extent = float((target.max(axis=0) - target.min(axis=0)).max())
        half = float(np.clip(2 * extent, LEAST_CUBE, MOST_CUBE)) / 2
        cloud = cloud[(np.abs(cloud - middle) <= half).all(axis=1)]
    if len(cloud) < CENTRES[0]:
        return None
    order = generator(seed, "contacts", 0).permutation(len(cloud))
    grasps = network.grasps(cloud[np.sort(order[:SCENE_POINTS])])
    T = grasps.T_cloud_grasp
    usable = (grasps.score > CONFIDENT) & (grasps.width <= opening)
    if target is not None:
        contacts = T[:, :3, 3] - grasps.width[:, None] / 2 * T[:, :3, 0]
        usable &= KDTree(target).query(contacts)[0] <= ON_TARGET
    best = np.argsort(-grasps.score, kind="stable")
    best = best[usable[best]][:SAMPLED]
    if not len(best):
        return None
    marks = rank(T[best])
    chosen = int(np.argmax(marks))
    return None if np.isneginf(marks[chosen]) else np.asarray(T[best[chosen]])


def by_room(reach: Reach, pregrasp: float, poses: Array) -> Array:
    """Rank (n,) of poses (n, 4, 4): the less of the arm's room at the grasp and pregrasp m before.

    -inf where one of the two is out of reach.
    """
    back = np.eye(4)
    back[2, 3] = -pregrasp
    out = []
    for T in poses:
        rooms = [reach(T), reach(T @ back)]
        out.append(-np.inf if None in rooms else min(r for r in rooms if r is not None))
    return np.array(out)
