"""A user's hand in simulation: its open and closed postures, grasp centre and camera."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import mujoco
import numpy as np

from dgeval.config import read_toml, validated
from dgeval.errors import Place, UsageError
from dgeval.geometry import Array, matrix_from_pose, transform
from dgeval.robots.hand import SimulatedHand
from dgeval.simulation.hand_urdf import HandFile, part_of

# share of the range, to both sides of 0, within which a joint's limits are alike: it spreads
# fingers, and stays at 0
ALIKE = 0.05
PRESHAPED = 0.35  # share of the way to closed, at most, that a grasp starts from
# the colour camera on the hand: beside the fingers, and looking along them; ours
CAMERAS = 8  # places around the hand that are tried
CAMERA_BESIDE_M, CAMERA_BEHIND_M = 0.10, 0.06
CAMERA_LOOKS_M = 0.20  # before the grasp centre, which it still sees


@dataclass(frozen=True, kw_only=True)
class ImportedHand(SimulatedHand):
    """A hand of a file. sha256: of all that it is made from. mesh_dirs: where its meshes are."""

    sha256: str
    mesh_dirs: tuple[str, ...]


@cache
def read_hand(path: Path) -> ImportedHand:
    """The hand of a URDF, or of a TOML file that names one. UsageError where it can't be used.

    Where the file says nothing: a joint whose limits lie alike on both sides of 0 stays there. Any
    other that turns closes from 0 to the limit that is farther, and one that slides closes from one
    limit to the other, so that the fingers come together.
    """
    file = HandFile(urdf=path.name)
    if path.suffix == ".toml":
        file = validated(HandFile, read_toml(path), "hand", path)
        folders = tuple(str(_named(d, path)) for d in file.mesh_dirs)
        file = file.model_copy(update={"mesh_dirs": folders})
        path = _named(file.urdf, path)
    part = part_of(path, file)
    model = part.model
    joints = tuple(model.joint(k).name for k in range(model.njnt))
    drives = tuple(model.actuator(k).name for k in range(model.nu))
    if not drives:
        raise UsageError("this hand has no joint that moves", Place(str(path)))
    unknown = sorted({*file.open, *file.closed, *file.force} - set(drives))
    if unknown:
        raise UsageError(
            f"no drive {unknown[0]!r}", Place(str(path)), f"there are {', '.join(drives)}"
        )
    ends = _open_and_closed(model, drives, file)
    T_base_palm = np.eye(4)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = file.palm or part.root.find("link").get("name")
    if palm not in part.finger_of:
        raise UsageError(f"no link {palm!r} to grasp with", Place(str(path)))
    T_base_palm[:3, :3] = data.body(palm).xmat.reshape(3, 3)
    T_base_palm[:3, 3] = data.body(palm).xpos
    opened, closed = ends
    centre = _meeting(model, drives, opened, closed)
    centre = centre if file.centre is None else np.array(file.centre)
    return ImportedHand(
        name=f"imported:{path.stem}",
        joints=joints,
        drives=drives,
        fingers=tuple(dict.fromkeys(f for f in part.finger_of.values() if f != "palm")),
        T_hand_palm=T_base_palm,
        centre=centre,
        close_s=file.close_s,
        positions=partial(_positions, model, drives),
        targets=partial(_targets, closed, file.close_s),
        grip=None,
        mismatch_sd=0.0,
        add=part.add,
        T_hand_camera=_camera(file, model, _positions(model, drives, opened), centre),
        open=opened,
        drive_speed=float(np.abs(closed - opened).max() / file.close_s),
        random_preshape=lambda rng: opened + PRESHAPED * rng.random() * (closed - opened),
        links=part.links,
        palm_frame=palm,
        sha256=part.sha256,
        mesh_dirs=tuple(dict.fromkeys([str(path.parent), *file.mesh_dirs])),
    )


def _named(name: str, where: Path) -> Path:
    """A path as a hand's file names it. UsageError where it uses a variable that is not set."""
    known = os.path.expandvars(name)
    if "$" in known:
        raise UsageError(f"a variable of {name!r} is not set", Place(str(where)))
    return where.parent / known


def _positions(model: mujoco.MjModel, drives: tuple[str, ...], values: Array) -> Array:
    """All joints (n,) from the drives (k,), coupled ones as MuJoCo couples them."""
    out = np.zeros(model.njnt)
    out[[model.joint(name).id for name in drives]] = values
    for _ in range(model.neq):  # chains
        for k in range(model.neq):
            offset, factor = model.eq_data[k, :2]
            out[model.eq_obj1id[k]] = offset + factor * out[model.eq_obj2id[k]]
    return out


def _targets(closed: Array, close_s: float, since_close: float, preshape: Array) -> Array:
    """Targets of the drives that lead from where they were to the closed hand."""
    share = float(np.clip(since_close / close_s, 0.0, 1.0))
    return np.asarray(preshape + share * (closed - preshape))


def _open_and_closed(
    model: mujoco.MjModel, drives: tuple[str, ...], file: HandFile
) -> tuple[Array, Array]:
    """(k,) drives, open and closed."""
    ids = [model.joint(name).id for name in drives]
    low, high = model.jnt_range[ids].T
    opened = np.clip(np.zeros(len(drives)), low, high)
    closed = opened.copy()
    for k, name in enumerate(drives):
        spreads = abs(low[k] + high[k]) < ALIKE * (high[k] - low[k])
        if model.jnt_limited[ids[k]] and not spreads:
            ends = [low[k], high[k]]
            if model.jnt_type[ids[k]] == mujoco.mjtJoint.mjJNT_SLIDE:
                ways = [np.where(np.arange(len(drives)) == k, end, opened) for end in ends]
                closed[k], opened[k] = sorted(
                    ends, key=lambda end: _apart(model, drives, ways[ends.index(end)])
                )
            else:
                closed[k] = max(ends, key=abs)
        opened[k] = file.open.get(name, opened[k])
        closed[k] = file.closed.get(name, closed[k])
    return opened, closed


def _tips(model: mujoco.MjModel, drives: tuple[str, ...], values: Array) -> Array:
    """(f, 3) m, of each finger the middle of the solid that is farthest along z when open."""
    data = mujoco.MjData(model)
    data.qpos[:] = _positions(model, drives, values)
    mujoco.mj_kinematics(model, data)
    fingers: dict[str, Array] = {}
    for g in range(model.ngeom):
        finger = model.geom(g).name.split("_")[0]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
        end = transform(T, model.geom_aabb[g, None, :3])[0]
        if finger != "palm" and (finger not in fingers or end[2] > fingers[finger][2]):
            fingers[finger] = end
    listed = np.array(list(fingers.values()))
    # bars of a linkage end short of the fingertips
    return np.asarray(listed[listed[:, 2] > 0.75 * listed[:, 2].max()])


def _apart(model: mujoco.MjModel, drives: tuple[str, ...], values: Array) -> float:
    """m, of the fingertips from their middle."""
    tips = _tips(model, drives, values)
    return float(np.linalg.norm(tips - tips.mean(axis=0), axis=1).sum())


def _meeting(model: mujoco.MjModel, drives: tuple[str, ...], opened: Array, closed: Array) -> Array:
    """(3,) m, the middle of the fingertips where they are nearest on their way."""
    way = [opened + share * (closed - opened) for share in np.linspace(0, 1, 11)]
    return np.asarray(_tips(model, drives, min(way, key=partial(_apart, model, drives))).mean(0))


def _camera(file: HandFile, model: mujoco.MjModel, opened: Array, centre: Array) -> Array:
    """T_base_camera (4, 4): as given, else beside the fingers, where the open hand hides least of
    what lies before it.
    """
    if file.camera is not None:
        return matrix_from_pose(np.array(file.camera))
    data = mujoco.MjData(model)
    data.qpos[:] = opened
    mujoco.mj_forward(model, data)
    best: tuple[int, Array] | None = None
    for angle in np.arange(CAMERAS) * 2 * np.pi / CAMERAS:
        beside = np.array([np.cos(angle), np.sin(angle), 0.0])
        at = CAMERA_BESIDE_M * beside - [0.0, 0.0, CAMERA_BEHIND_M]
        hidden = 0
        for ahead in (0.0, 0.05, 0.1, 0.2):
            for x in (-0.04, 0.0, 0.04):
                for y in (-0.04, 0.0, 0.04):
                    to = centre + np.array([x, y, ahead]) - at
                    hit = mujoco.mj_ray(model, data, at, to, None, 1, -1, np.zeros(1, np.int32))
                    hidden += 0 <= hit < 1
        if best is None or hidden < best[0]:
            z = centre + np.array([0.0, 0.0, CAMERA_LOOKS_M]) - at
            z /= np.linalg.norm(z)
            x_axis = np.cross(beside, z)
            x_axis /= np.linalg.norm(x_axis)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = np.column_stack([x_axis, np.cross(z, x_axis), z]), at
            best = hidden, T
    assert best is not None
    return best[1]
