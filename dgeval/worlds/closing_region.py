"""Where a hand closes: the hull of what its fingertips and pads sweep in closing on nothing.

And how far an object reaches into it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from dgeval.geometry import Array, invert, transform
from dgeval.robots.hand import BASE, Hand
from dgeval.worlds.scene import pose_of

SAMPLES = 12  # of the closing motion; ours
AROUND = 12  # points on the rim of a round solid
LATTICE_M = 0.012  # between the points that fill an object, at most


@dataclass(frozen=True)
class ClosingRegion:
    """A convex region in the hand's base frame: normals (n, 3) and offsets (n,) m of its faces.

    deepest m: how deep the deepest point lies inside it.
    """

    normals: Array
    offsets: Array
    deepest: float

    def depth(self, points: Array) -> Array:
        """(m,) m, how deep points (m, 3) of the hand's base frame lie inside it.

        Outside it is negative, and no point is nearer to the region than that.
        """
        return np.asarray(-(points @ self.normals.T + self.offsets).max(axis=1))


def closing_region(model: mujoco.MjModel, hand: Hand, drives: Array) -> ClosingRegion:
    """The hull of what the last link of every finger sweeps in closing from drives (k,), rad or m.

    model: a world with the hand. Fingertips and pads are the solids of fingers with no further one
    after them; nothing stops them but the limits of their joints. ValueError where there are none.
    """
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in hand.joints]
    lower, upper = (
        np.array([j.range[k] if model.jnt_limited[j.id] else fill for j in joints])
        for k, fill in ((0, -np.inf), (1, np.inf))
    )
    at = [int(j.qposadr[0]) for j in joints]
    solids = [(g, _points_of(model, g)) for g in last_solids(model, hand)]
    if not solids:
        raise ValueError(f"no finger of {hand.name} has a solid")
    swept = []
    for since_s in np.linspace(0.0, hand.close_s, SAMPLES):
        reached = hand.positions(hand.targets(float(since_s), drives))
        data.qpos[at] = np.clip(reached, lower, upper)
        mujoco.mj_kinematics(model, data)
        T_hand_base = invert(pose_of(data, BASE))
        for geom, points in solids:
            R = data.geom_xmat[geom].reshape(3, 3)
            swept.append(transform(T_hand_base, points @ R.T + data.geom_xpos[geom]))
    faces = ConvexHull(np.concatenate(swept)).equations
    normals, offsets = faces[:, :3], faces[:, 3]
    # the centre and radius of the largest ball inside
    ball = linprog(
        [0, 0, 0, -1], A_ub=np.column_stack([normals, np.ones(len(normals))]), b_ub=-offsets,
        bounds=[(None, None)] * 3 + [(0, None)],
    )  # fmt: skip
    assert ball.x is not None  # a hull has an inside
    return ClosingRegion(normals, offsets, float(ball.x[3]))


def points_within(model: mujoco.MjModel, geoms: list[int]) -> Array:
    """Points (n, 3) m that fill some solids of one body, in the body's frame.

    They are the corners of each solid's hull and a lattice in it.
    """
    out = []
    for geom in geoms:
        hull = ConvexHull(_points_of(model, geom))
        corners = hull.points[hull.vertices]
        least, most = corners.min(axis=0), corners.max(axis=0)
        counts = np.ceil((most - least) / LATTICE_M).astype(int) + 1
        axes = [np.linspace(a, b, n) for a, b, n in zip(least, most, counts, strict=True)]
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        faces = hull.equations
        inside = (lattice @ faces[:, :3].T + faces[:, 3] <= 1e-9).all(axis=1)
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, model.geom_quat[geom])
        points = np.concatenate([corners, lattice[inside]])
        out.append(points @ R.reshape(3, 3).T + model.geom_pos[geom])
    return np.concatenate(out)


def last_solids(model: mujoco.MjModel, hand: Hand) -> list[int]:
    """The solids of a hand's fingers on bodies after which no body has one."""
    base = model.body(BASE).id
    solid = [
        g
        for g in range(model.ngeom)
        if model.geom_contype[g] == 2 and model.geom(g).name.split("_")[0] in hand.fingers
    ]
    with_solids = {int(model.geom_bodyid[g]) for g in solid} - {base}
    before: set[int] = set()
    for body in with_solids:
        above = int(model.body_parentid[body])
        while above not in (0, base):
            before.add(above)
            above = int(model.body_parentid[above])
    return [g for g in solid if int(model.geom_bodyid[g]) in with_solids - before]


def _points_of(model: mujoco.MjModel, geom: int) -> Array:
    """Points (n, 3) m whose hull is a solid, in its own frame; a round one's within 4 % of it."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        return np.asarray(model.mesh_vert[first : first + count], dtype=float)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return np.asarray(corners * size)
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(AROUND)], axis=1)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        ends = np.array([[0, 0, -size[1]], [0, 0, size[1]]])
        return np.concatenate([rim * size[0] + end for end in ends])
    height = np.sin(np.linspace(-np.pi / 2, np.pi / 2, AROUND // 2 + 1))
    ball = np.concatenate([rim * np.sqrt(1 - z * z) + [0, 0, z] for z in height])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        ends = np.array([[0, 0, -size[1]], [0, 0, size[1]]])
        return np.concatenate([ball * size[0] + end for end in ends])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.asarray(ball * size[0])
    assert kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID, kind
    return np.asarray(ball * size)
