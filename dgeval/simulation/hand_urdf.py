"""A hand's URDF as MuJoCo imports it, and the file that says what a URDF doesn't.

Nothing that the verdict's twin reads descriptions with is used here: an error there would otherwise
be in the truth as well, and no figure would show it. Drives, joint friction and contacts are set in
the hand's file, or here, and are not those of the twin.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from lxml import etree
from pydantic import BaseModel, ConfigDict, Field

from dgeval.errors import Place, UsageError
from dgeval.geometry import Array, matrix_from_pose
from dgeval.robots.hand import BASE
from dgeval.robots.mjcf import place
from dgeval.robots.urdf import CAMERA_FRAME, FLANGE, fixed

# names that the arm and the world have already; a hand's own are then written with this in front
TAKEN = {"base_link", FLANGE, CAMERA_FRAME, "object", "belt", "floor"}
TAKEN |= {f"link_{k}" for k in range(1, 8)} | {f"arm_{k}" for k in range(1, 8)}
PREFIX = "hand_"
ATTACHED = "attached/"  # in front of names of parts that only MuJoCo sees
READ_BY_MUJOCO = (".stl", ".obj", ".msh")
# Of a joint that turns, and of one that slides; ours, and not the twin's.
DAMPING, ARMATURE, FRICTION = (0.03, 12.0), (3e-4, 0.15), (0.01, 0.5)
# kg m^2, of a joint of a linkage: with less, its contacts become unstable
LINKAGE_KGM2 = 1e-3
# Parts of a mesh that fills less than that share of its hull: finer than the twin's
FILLS, MOST_PARTS, PART_VOXELS = 0.98, 16, 20000
FLAT_M = 1e-4  # spread of a part's corners across, of one that is left out: MuJoCo refuses it
FORCE = (0.9, 25.0)  # Nm, N, of a drive whose file states none
ALL_FORCE_AT = (0.2, 0.006)  # rad, m, of position error, at which a drive gives all its force


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


@dataclass(frozen=True)
class HandUrdf:
    """The hand's part of a URDF, and what MuJoCo makes of it.

    root: the robot element. source: the file that it is from.
    """

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
            )
        for couple in spec.equalities:
            couple.solref = [0.010, 1]
        coupled = {name for e in spec.equalities for name in (e.name1, e.name2)}
        for body in spec.bodies[1:]:
            body.gravcomp = 1
            _take_apart(spec, body)
            for k, geom in enumerate(body.geoms):
                geom.name = f"{self.finger_of[body.name]}_{body.name}_{k}"
                geom.contype, geom.conaffinity, geom.condim, geom.priority = 2, 1, 4, 1
                geom.friction = [self.file.friction, 0.005, 0.0001]
                geom.solref, geom.solimp = [0.005, 1], [0.9, 0.98, 0.001, 0.5, 2]
            for joint in body.joints:
                slides = int(joint.type == mujoco.mjtJoint.mjJNT_SLIDE)
                joint.damping = [DAMPING[slides], 0, 0]
                joint.armature, joint.frictionloss = ARMATURE[slides], FRICTION[slides]
                if joint.name in coupled and not slides:
                    joint.armature = LINKAGE_KGM2
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

    def links(self) -> list[str]:
        """The hand's links and joints as URDF text, and the joint that holds them.

        A link looks as its solids do, which are what the simulated camera sees.
        """
        root = self.root.find("link").get("name")
        mount = matrix_from_pose(np.array(self.file.mount))
        listed = [fixed("hand_root", FLANGE, root, mount)]
        for element in self.root:
            kept = etree.fromstring(etree.tostring(element))
            if kept.find("collision") is not None:
                etree.strip_elements(kept, "visual", with_tail=False)
            listed.append(str(etree.tostring(kept, encoding="unicode", with_tail=False)))
        return listed


def _take_apart(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Put convex parts in the place of each mesh, which MuJoCo would take for its hull."""
    for geom in list(body.geoms):
        if geom.type != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        asset = spec.mesh(geom.meshname)
        parts = _parts(asset.file, tuple(asset.scale))
        if len(parts) == 1:
            continue
        for k, vertices in enumerate(parts):
            name = f"{body.name}_{geom.meshname}_part_{k}"
            spec.add_mesh(name=name, uservert=vertices.ravel())
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=geom.pos, quat=geom.quat
            )
        spec.delete(geom)


@lru_cache(maxsize=128)
def _parts(file: str, scale: tuple[float, ...]) -> tuple[Array, ...]:
    """Corners (n, 3) m of the convex parts of a mesh's file; one part where it is convex."""
    mesh: Any = trimesh.load(file, force="mesh")
    mesh.apply_scale(scale)
    if not mesh.is_volume or mesh.is_convex or mesh.volume > FILLS * mesh.convex_hull.volume:
        return (np.asarray(mesh.vertices),)
    found = trimesh.decomposition.convex_decomposition(
        mesh, maxConvexHulls=MOST_PARTS, resolution=PART_VOXELS
    )
    parts = [np.asarray(part["vertices"], dtype=np.float64) for part in found]
    return tuple(p for p in parts if np.linalg.svd(p - p.mean(axis=0))[1][2] > FLAT_M)


def part_of(path: Path, file: HandFile) -> HandUrdf:
    """The URDF of the hand alone: what hangs on its root, by names that nothing else has."""
    # published files hold remains of xacro that are not XML
    parser = etree.XMLParser(recover=True, remove_comments=True, resolve_entities=False)
    try:
        robot = etree.fromstring(path.read_bytes(), parser)
    except OSError as error:
        raise UsageError(f"can't read the hand ({error.strerror})", Place(str(path))) from None
    except etree.XMLSyntaxError:
        robot = None
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
    own = {joint.get("name") for joint in part.iterfind("joint")}
    for mimic in part.iter("mimic"):
        if mimic.get("joint") not in own:  # MuJoCo drops it with a word in a file
            joint = mimic.getparent().get("name")
            raise UsageError(
                f"joint {joint} mimics {mimic.get('joint')!r}, which is no joint of this hand",
                Place(str(path)),
            )
    for element in part.iter("link", "joint", "parent", "child", "mimic"):
        for key in ("name", "link", "joint"):
            if element.get(key) in TAKEN:
                element.set(key, PREFIX + element.get(key))
    return HandUrdf(file, part, path)
