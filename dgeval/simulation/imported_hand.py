"""A user's hand in simulation, from a URDF by MuJoCo's own importer.

The verdict's twin reads a description in `dgeval.robots`. Nothing of that is used here: an error
there would otherwise be in the truth as well, and no figure would show it. Drives, joint friction
and contacts are set in the hand's file, or here, and are not those of the twin.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from lxml import etree
from pydantic import BaseModel, ConfigDict, Field

from dgeval.config import read_toml, validated
from dgeval.errors import Place, UsageError
from dgeval.geometry import Array, matrix_from_pose, transform
from dgeval.robots.hand import BASE, SimulatedHand
from dgeval.robots.mjcf import place
from dgeval.robots.urdf import fixed

# names that the arm and the world have already; a hand's own are then written with this in front
TAKEN = {"base_link", "hand_base", "camera_color_optical_frame", "object", "belt", "floor"}
TAKEN |= {f"link_{k}" for k in range(1, 8)} | {f"arm_{k}" for k in range(1, 8)}
PREFIX = "hand_"
ATTACHED = "attached/"  # in front of names of parts that only MuJoCo sees
READ_BY_MUJOCO = (".stl", ".obj", ".msh")
# share of the range, to both sides of 0, within which a joint's limits are alike: it spreads
# fingers, and stays at 0
ALIKE = 0.05
PRESHAPED = 0.35  # share of the way to closed, at most, that a grasp starts from
# Of a joint that turns, and of one that slides; ours, and not the twin's.
DAMPING, ARMATURE, FRICTION = (0.03, 12.0), (3e-4, 0.15), (0.01, 0.5)
FORCE = (0.9, 25.0)  # Nm, N, of a drive whose file states none
ALL_FORCE_AT = (0.2, 0.006)  # rad, m, of position error, at which a drive gives all its force
# the colour camera on the hand: beside the fingers, and looking along them; ours
CAMERAS = 8  # places around the hand that are tried
CAMERA_BESIDE_M, CAMERA_BEHIND_M, CAMERA_LOOKS_AT_M = 0.10, 0.03, 0.30


class HandFile(BaseModel):
    """A hand to simulate, as in a TOML file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    urdf: str = Field(description="file, from the folder of this one; $NAME is read from outside")
    mesh_dirs: tuple[str, ...] = Field((), description="folders in which meshes are looked for")
    root: str | None = Field(None, description="the hand's first link; default: the first of all")
    palm: str | None = Field(None, description="frame of grasps; default: root")
    mount: tuple[float, ...] = Field(
        (0, 0, 0, 0, 0, 0, 1),
        min_length=7,
        max_length=7,
        description="x y z m qx qy qz qw of root in a frame whose z axis points along the fingers",
    )
    camera: tuple[float, ...] | None = Field(
        None, min_length=7, max_length=7, description="optical frame, in the same frame"
    )
    centre: tuple[float, float, float] | None = Field(
        None, description="m, of what is held, in the same frame; default: between the fingertips"
    )
    open: dict[str, float] = Field({}, description="rad or m, by joint")
    closed: dict[str, float] = Field({}, description="rad or m, by joint")
    force: dict[str, float] = Field({}, description="Nm or N that a drive gives, by joint")
    close_s: float = Field(0.4, gt=0, le=0.4)
    friction: float = Field(1.0, gt=0, description="of the fingers, sliding")


@dataclass(frozen=True, kw_only=True)
class ImportedHand(SimulatedHand):
    """A hand of a file. sha256: of all that it is made from. mesh_dirs: where its meshes are."""

    sha256: str
    mesh_dirs: tuple[str, ...]


@dataclass(frozen=True)
class _Imported:
    """The hand's part of a URDF, and what MuJoCo makes of it."""

    file: HandFile
    root: Any
    source: Path

    @cached_property
    def text(self) -> str:
        """URDF for MuJoCo, its meshes by full path."""
        copy = etree.fromstring(etree.tostring(self.root))
        etree.strip_elements(copy, "visual")
        for mesh in copy.iter("mesh"):
            mesh.set("filename", str(self._mesh(mesh.get("filename") or "")))
        extension = etree.SubElement(copy, "mujoco")
        etree.SubElement(
            extension,
            "compiler",
            strippath="false",
            discardvisual="true",
            fusestatic="false",
            balanceinertia="true",
            boundmass="0.01",
            boundinertia="1e-5",
        )
        return str(etree.tostring(copy, encoding="unicode"))

    @cached_property
    def sha256(self) -> str:
        """Of the hand's part of the URDF, its meshes, and what its file sets."""
        total = hashlib.sha256(etree.tostring(self.root))
        for mesh in etree.fromstring(self.text).iter("mesh"):
            total.update(Path(mesh.get("filename")).read_bytes())
        total.update(self.file.model_dump_json(exclude={"urdf", "mesh_dirs"}).encode())
        return total.hexdigest()

    def _mesh(self, name: str) -> Path:
        path = name.split("://", 1)[-1]
        if not path.lower().endswith(READ_BY_MUJOCO):
            raise UsageError(
                f"MuJoCo reads no mesh {name}",
                Place(str(self.source)),
                f"convert it to one of {', '.join(READ_BY_MUJOCO)}",
            )
        folders = [self.source.parent, *map(Path, self.file.mesh_dirs)]
        for folder in folders:
            for tail in (path, path.split("/", 1)[-1]):
                if (found := folder / tail).is_file():
                    return found.resolve()
        where = ", ".join(map(str, folders))
        raise UsageError(
            f"no mesh {name} in {where}", Place(str(self.source)), "give mesh_dirs = [...]"
        )

    def spec(self) -> mujoco.MjSpec:
        """The hand as MuJoCo imports it, with drives, friction and contacts."""
        try:
            spec = mujoco.MjSpec.from_string(self.text)
        except ValueError as error:
            raise UsageError(f"MuJoCo can't import it ({error})", Place(str(self.source))) from None
        couplings = len(list(self.root.iter("mimic")))
        if len(spec.equalities) != couplings:
            raise UsageError(
                f"of {couplings} mimic joints MuJoCo imports {len(spec.equalities)}",
                Place(str(self.source)),
                "name joints of the hand in mimic",
            )
        for couple in spec.equalities:
            couple.solref = [0.005, 1]
        for body in spec.bodies[1:]:
            body.gravcomp = 1
            for k, geom in enumerate(body.geoms):
                geom.name = f"{self.finger_of[body.name]}_{body.name}_{k}"
                geom.contype, geom.conaffinity, geom.condim, geom.priority = 2, 1, 4, 1
                geom.friction = [self.file.friction, 0.005, 0.0001]
                geom.solref, geom.solimp = [0.005, 1], [0.9, 0.98, 0.001, 0.5, 2]
            for joint in body.joints:
                slides = int(joint.type == mujoco.mjtJoint.mjJNT_SLIDE)
                # one number in MuJoCo 3, three in 4
                joint.damping = np.resize(DAMPING[slides], np.shape(joint.damping))
                joint.armature, joint.frictionloss = ARMATURE[slides], FRICTION[slides]
        return spec

    def _drive(self, spec: mujoco.MjSpec, name: str, slides: int) -> None:
        force = self.file.force.get(name, FORCE[slides])
        stiffness = force / ALL_FORCE_AT[slides]
        drive = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.set_to_position(kp=stiffness, kv=0.03 * stiffness)
        drive.forcelimited, drive.forcerange = True, [-force, force]

    @cached_property
    def finger_of(self) -> dict[str, str]:
        """By link, "palm", or the name of the first moving link above it, without "_"."""
        above = {j.find("child").get("link"): j for j in self.root.iterfind("joint")}
        out = {}
        for link in self.root.iterfind("link"):
            name = link.get("name")
            finger = "palm"
            while name in above:
                if above[name].get("type") != "fixed":
                    finger = name.replace("_", "-")
                name = above[name].find("parent").get("link")
            out[link.get("name")] = finger
        return out

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The hand alone, with its frame z along the fingers."""
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        self.add(spec, spec.worldbody.add_body(name=BASE))
        return spec.compile()

    def add(self, spec: mujoco.MjSpec, base: mujoco.MjsBody) -> None:
        """Put the hand below a body."""
        frame = base.add_frame()
        place(frame, matrix_from_pose(np.array(self.file.mount)))
        spec.attach(self.spec(), frame=frame, prefix=ATTACHED)
        # MuJoCo warns of an attachment without a prefix; joints are named as in recordings
        followers = set()
        for couple in spec.equalities:
            if couple.name1.startswith(ATTACHED):
                couple.name1 = couple.name1.removeprefix(ATTACHED)
                couple.name2 = couple.name2.removeprefix(ATTACHED)
                followers.add(couple.name1)
        for item in (*spec.bodies, *spec.geoms, *spec.joints):
            item.name = item.name.removeprefix(ATTACHED)
        imported = {joint.get("name") for joint in self.root.iterfind("joint")}
        for joint in spec.joints:
            if joint.name in imported - followers:
                self._drive(spec, joint.name, int(joint.type == mujoco.mjtJoint.mjJNT_SLIDE))


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
    part = _Imported(file, _part_of(path, file), path)
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
        links=lambda: _links(part),
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


def _part_of(path: Path, file: HandFile) -> Any:
    """The URDF of the hand alone: what hangs on its root, by names that nothing else has."""
    try:
        tree = etree.parse(str(path), etree.XMLParser(recover=True, remove_comments=True))
    except OSError as error:
        raise UsageError(f"can't read the hand ({error})", Place(str(path))) from None
    robot = tree.getroot()
    if robot is None or robot.tag != "robot":
        raise UsageError("this is not a URDF", Place(str(path)))
    below: dict[str, list[str]] = {}
    for joint in robot.iterfind("joint"):
        child, parent = joint.find("child"), joint.find("parent")
        if child is None or parent is None:
            raise UsageError(f"joint {joint.get('name')} joins nothing", Place(str(path)))
        below.setdefault(parent.get("link"), []).append(child.get("link"))
    names = [link.get("name") for link in robot.iterfind("link")]
    children = {c for listed in below.values() for c in listed}
    roots = [n for n in names if n not in children]
    root = file.root or (roots[0] if roots else "")
    if root not in names:
        raise UsageError(f"no link {root!r}", Place(str(path)), f"root: one of {', '.join(names)}")
    kept = [root]
    for name in kept:
        kept += [c for c in below.get(name, []) if c not in kept]
    part = etree.Element("robot", name=robot.get("name") or path.stem)
    for name in kept:
        part.append(next(e for e in robot.iterfind("link") if e.get("name") == name))
    for joint in robot.iterfind("joint"):
        if joint.find("parent").get("link") in kept:
            part.append(joint)
    for element in part.iter("link", "joint", "parent", "child", "mimic"):
        for key in ("name", "link", "joint"):
            if element.get(key) in TAKEN:
                element.set(key, PREFIX + element.get(key))
    return part


def _links(part: _Imported) -> list[str]:
    """The hand's links and joints as URDF text, and the joint that holds them."""
    root = part.root.find("link").get("name")
    mount = matrix_from_pose(np.array(part.file.mount))
    listed = [fixed("hand_root", BASE, root, mount)]
    for element in part.root:
        kept = etree.fromstring(etree.tostring(element))
        listed.append(str(etree.tostring(kept, encoding="unicode", with_tail=False)))
    return listed


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
            z = np.array([*centre[:2], CAMERA_LOOKS_AT_M]) - at
            z /= np.linalg.norm(z)
            x_axis = np.cross(beside, z)
            x_axis /= np.linalg.norm(x_axis)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = np.column_stack([x_axis, np.cross(z, x_axis), z]), at
            best = hidden, T
    assert best is not None
    return best[1]
