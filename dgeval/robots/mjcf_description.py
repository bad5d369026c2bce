"""A description from MJCF text, MuJoCo's own format.

MuJoCo resolves its defaults, angles and frames; meshes are found and read as those of a URDF. A
body is a link, and so is a site; of several joints on one body each has a link of its own.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.errors import Place, UsageError, describe
from dgeval.geometry import Array, invert
from dgeval.robots.description import Coupling, Description, Joint, Kind, LinkShape, resolved
from dgeval.robots.link_shapes import (
    UnusableMeshError,
    capsules_of,
    hull_of,
    mesh_hull,
    primitive,
    without_solids,
)

if TYPE_CHECKING:
    import mujoco

# what names other files, whose content the text alone does not have
ELSEWHERE = ("include", "model", "plugin", "attach")
# MuJoCo's numbers of kinds of joints
HINGE, UNREAD = 3, {0: "free", 1: "ball"}
STAND_IN_M = 1e-3  # radius of the sphere in place of a mesh while MuJoCo resolves the tree
# rad; what limits written in radians are at most, where they are read as degrees (2 pi)
MOST_RAD_AS_DEGREES = 0.11
ELLIPSOID = 12  # points around an ellipsoid
PIECE = 4096  # characters that are read at once until a text's first element


def is_mjcf(text: str) -> bool:
    """Whether the first element of a text is MJCF's."""
    parser: Any = ET.XMLPullParser(["start"])
    text = text.lstrip("\ufeff \t\r\n")
    try:
        for k in range(0, len(text), PIECE):
            parser.feed(text[k : k + PIECE])
            first = next(parser.read_events(), None)
            if first is not None:
                return bool(first[1].tag == "mujoco")
    except ET.ParseError:
        pass
    return False


def load_mjcf(text: str, source: str, mesh_dirs: tuple[str, ...], radius: float) -> Description:
    """Parse MJCF text; as `loading.load_description`.

    UsageError where MuJoCo refuses it, or where it includes other files.
    """
    notes: list[str] = []
    spec, meshes = _spec(text, source)
    try:
        model = spec.compile()
    except ValueError as error:
        raise UsageError(
            f"the robot description is no MJCF that MuJoCo takes ({describe(error)})", Place(source)
        ) from error
    links = [model.body(b).name or f"body_{b}" for b in range(model.nbody)]
    joints = _joints(model, links, notes)
    notes += _in_degrees(text, joints)
    shapes: dict[str, list[LinkShape]] = {}
    unusable: list[str] = []
    substituted: list[str] = []
    mass_centres = {
        link: model.body_ipos[b].astype(np.float64)
        for b, link in enumerate(links)
        if b and spec.bodies[b].explicitinertial
    }
    for b, link in enumerate(links):
        shapes[link], lacking = _shapes(model, b, link, meshes, mesh_dirs)
        unusable += [f"{what} (link {link})" for what in lacking]
        if lacking and not shapes[link]:
            shapes[link] = capsules_of(link, joints, mass_centres.get(link), radius)
            substituted.append(link)
    if unusable:
        notes.append(without_solids(unusable, substituted))
    numbers = [j.origin for j in joints.values()]
    numbers += [s.T_link_shape for listed in shapes.values() for s in listed]
    if not all(np.isfinite(n).all() for n in numbers):
        raise UsageError("the robot description has numbers that are none", Place(source))
    return Description(joints, shapes, notes, mass_centres, radius)


def _in_degrees(text: str, joints: dict[str, Joint]) -> list[str]:
    """A note on a part of a larger model, which alone means degrees and was written in radians."""
    compiler = ET.fromstring(text).find("compiler")
    turns = [j.upper - j.lower for j in joints.values() if j.kind == "revolute"]
    limited = [span for span in turns if np.isfinite(span)]
    if not limited or max(limited) > MOST_RAD_AS_DEGREES:
        return []
    if compiler is not None and compiler.get("angle") is not None:
        return []
    return [
        f"no joint turns by more than {np.degrees(max(limited)):.2g} degrees, which is what MJCF's "
        'angles are in without a <compiler angle="radian"/>: does it miss one?'
    ]


def _spec(text: str, source: str) -> tuple[Any, dict[str, Any]]:
    """The text for MuJoCo, which reads no file for it; and by geom's name, its mesh."""
    import mujoco

    try:
        tags = {element.tag for element in ET.fromstring(text).iter()}
        found = sorted(tags & set(ELSEWHERE))
        if found:
            raise UsageError(
                f"the robot description is MJCF with <{found[0]}>, which names other files; "
                "give it as one text, as mj_saveLastXML writes it",
                Place(source),
            )
        spec = mujoco.MjSpec.from_string(text)
    except (ValueError, ET.ParseError) as error:
        raise UsageError(
            f"the robot description is no MJCF that MuJoCo takes ({describe(error)})", Place(source)
        ) from error
    by_name = {mesh.name or _stem(mesh.file): mesh for mesh in spec.meshes}
    meshes: dict[str, Any] = {}
    for k, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"geom {k}"
        geom.material = ""
        if geom.meshname or geom.type in (
            mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF,
        ):  # fmt: skip
            if geom.meshname in by_name:
                mesh = by_name[geom.meshname]
                meshes[geom.name] = SimpleNamespace(
                    filename=mesh.file, scale=np.array(mesh.scale), vertices=np.array(mesh.uservert)
                )
            else:
                meshes[geom.name] = f"a mesh {geom.meshname!r} that the text does not have"
                if not geom.meshname:
                    meshes[geom.name] = "a height field or a signed distance field"
            geom.type, geom.meshname, geom.hfieldname = mujoco.mjtGeom.mjGEOM_SPHERE, "", ""
            geom.size = [STAND_IN_M] * 3
    for site in spec.sites:
        site.material = ""
    for listed in (spec.meshes, spec.textures, spec.materials, spec.hfields, spec.skins, spec.keys):
        for item in list(listed):
            spec.delete(item)
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    return spec, meshes


def _stem(file: str) -> str:
    return file.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]


def _pose(position: Array, quat_wxyz: Array) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quat_wxyz, scalar_first=True).as_matrix()
    T[:3, 3] = position
    return T


def _joints(model: mujoco.MjModel, links: list[str], notes: list[str]) -> dict[str, Joint]:
    """By child link. A joint whose axis does not go through its body's frame has a link there."""
    names = [model.joint(j).name or f"joint_{j}" for j in range(model.njnt)]
    coupled = resolved(names, _coupling(model, names, notes), notes)
    out: dict[str, Joint] = {}

    def fixed(parent: str, child: str, origin: Array) -> None:
        name = f"{parent} to {child}"
        out[child] = Joint(name, parent, child, "fixed", origin, np.eye(3)[0], name, 1.0, 0.0)

    for b in range(1, model.nbody):
        above, origin = links[model.body_parentid[b]], _pose(model.body_pos[b], model.body_quat[b])
        first = model.body_jntadr[b]
        for j in range(first, first + model.body_jntnum[b]):
            kind = int(model.jnt_type[j])
            if kind in UNREAD:
                notes.append(f"the {UNREAD[kind]} joint {names[j]} is taken as fixed")
                continue
            axis = model.jnt_axis[j].astype(np.float64)
            anchor = np.eye(4)
            anchor[:3, 3] = model.jnt_pos[j]
            limited = bool(model.jnt_limited[j])
            low, high = model.jnt_range[j] if limited else (-np.inf, np.inf)
            joint = Joint(
                names[j],
                above,
                f"{links[b]} on {names[j]}",
                "revolute" if kind == HINGE else "prismatic",
                origin @ anchor,
                axis,
                *coupled[names[j]],
                float(low),
                float(high),
            )
            # at its reference position it has not moved
            start = -float(model.qpos0[model.jnt_qposadr[j]])
            out[joint.child] = replace(joint, origin=joint.moved(start))
            above, origin = joint.child, invert(anchor)
        last = out.get(above)
        if last is not None and above not in links and np.allclose(origin, np.eye(4)):
            del out[above]
            out[links[b]] = replace(last, child=links[b])
        else:
            fixed(above, links[b], origin)
    for s in range(model.nsite):
        name = model.site(s).name
        if name and name not in out and name not in links:
            fixed(links[model.site_bodyid[s]], name, _pose(model.site_pos[s], model.site_quat[s]))
    return out


def _coupling(model: mujoco.MjModel, names: list[str], notes: list[str]) -> Coupling:
    """What equality constraints couple. Joints that a tendon drives together are named."""
    import mujoco

    direct: Coupling = {}
    for e in range(model.neq):
        if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[e]:
            continue
        one, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        a0, a1, *more = model.eq_data[e][:5].tolist()
        if other < 0 or any(more):
            notes.append(f"joint {names[one]} is coupled otherwise than by a factor: taken as free")
            continue
        at, at_other = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (one, other))
        direct[names[one]] = names[other], a1, at + a0 - a1 * at_other
    told = []
    for t in range(model.ntendon):
        first, count = model.tendon_adr[t], model.tendon_num[t]
        wraps = range(first, first + count)
        if all(model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT for w in wraps) and count > 1:
            along = [names[model.wrap_objid[w]] for w in wraps]
            if sum(name not in direct for name in along) > 1:
                told.append(f"a tendon drives {', '.join(along)} together: each must be recorded")
    notes += dict.fromkeys(told)
    return direct


def _shapes(
    model: mujoco.MjModel,
    body: int,
    link: str,
    meshes: dict[str, Any],
    mesh_dirs: tuple[str, ...],
) -> tuple[list[LinkShape], list[str]]:
    """Shapes of a body, and what gives none; those that collide, else all."""
    first, count = model.body_geomadr[body], model.body_geomnum[body]
    geoms = range(first, first + count)
    solid = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
    out: list[LinkShape] = []
    unusable: list[str] = []
    rough = bool(solid) and any(model.geom(g).name in meshes for g in geoms if g not in solid)
    for g in solid or geoms:
        T = _pose(model.geom_pos[g], model.geom_quat[g])
        name = model.geom(g).name
        try:
            if name not in meshes:
                shape = _primitive(link, T, int(model.geom_type[g]), model.geom_size[g], rough)
            elif isinstance(meshes[name], str):
                raise UnusableMeshError(meshes[name])
            elif meshes[name].filename:
                shape = mesh_hull(link, T, meshes[name], mesh_dirs)
            else:
                vertices = meshes[name].vertices.reshape(-1, 3) * meshes[name].scale
                shape = hull_of(link, T, vertices, None, "a mesh in the text")
        except UnusableMeshError as error:
            unusable.append(str(error))
            continue
        if shape is not None:
            out.append(shape)
    return out, unusable


def _primitive(link: str, T: Array, kind: int, size: Array, rough: bool) -> LinkShape | None:
    """A solid of MuJoCo's sizes; None for a plane, which is no part of a robot."""
    import mujoco

    kinds: dict[int, tuple[Kind, int]] = {
        int(mujoco.mjtGeom.mjGEOM_SPHERE): ("sphere", 1),
        int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", 2),
        int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
        int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    }
    if kind == int(mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        u, v = np.meshgrid(
            np.linspace(0, 2 * np.pi, ELLIPSOID, endpoint=False), np.linspace(0, np.pi, ELLIPSOID)
        )
        ball = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
        return hull_of(link, T, ball.reshape(-1, 3) * size, None, "an ellipsoid")
    if kind not in kinds:
        return None
    name, count = kinds[kind]
    return primitive(link, name, T, tuple(float(v) for v in size[:count]), rough)
