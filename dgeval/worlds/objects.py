"""Objects to grasp: those of the two papers, procedural ones to train on, and users' meshes.

Object frame: origin at the centre of the bounding box (of a mug: of its body), z up as it stands on
the belt. Metres, kilograms. Each object is a set of convex parts for contact and, where those would
not look right, a mesh that is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from dgeval.determinism import generator
from dgeval.geometry import Array, transform
from dgeval.robots.mjcf import place
from dgeval.worlds.textures import Look, add_material

Kind = Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "hull"]
OBJECT_GROUP = 2  # MuJoCo's geom group of the drawn object, so that it can be drawn alone
# MuJoCo's geom type of each kind of part; hulls are meshes
GEOM = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
}


@dataclass(frozen=True)
class Part:
    """A convex solid of an object.

    size, m, as in MuJoCo: box, half lengths; sphere, radius; cylinder and capsule, radius and half
    length; ellipsoid, semi-axes. vertices (n, 3) m: of a hull.
    """

    kind: Kind
    T_object_part: Array
    size: tuple[float, ...] = ()
    vertices: Array | None = None

    def volume(self) -> float:
        """Volume, m^3."""
        s = self.size
        if self.kind == "box":
            return 8 * s[0] * s[1] * s[2]
        if self.kind == "sphere":
            return 4 / 3 * np.pi * s[0] ** 3
        if self.kind == "cylinder":
            return 2 * np.pi * s[0] ** 2 * s[1]
        if self.kind == "capsule":
            return np.pi * s[0] ** 2 * (2 * s[1] + 4 / 3 * s[0])
        if self.kind == "ellipsoid":
            return 4 / 3 * np.pi * s[0] * s[1] * s[2]
        assert self.vertices is not None
        return float(ConvexHull(self.vertices).volume)

    def lowest(self, direction: Array) -> float:
        """Least coordinate of the part, m, along a unit direction (3,) of the object frame."""
        d = self.T_object_part[:3, :3].T @ direction
        s = np.array(self.size)
        if self.kind == "box":
            reach = float(np.abs(d) @ s)
        elif self.kind == "sphere":
            reach = float(s[0])
        elif self.kind == "cylinder":
            reach = float(s[0] * np.hypot(d[0], d[1]) + s[1] * abs(d[2]))
        elif self.kind == "capsule":
            reach = float(s[0] + s[1] * abs(d[2]))
        elif self.kind == "ellipsoid":
            reach = float(np.linalg.norm(d * s))
        else:
            assert self.vertices is not None
            reach = -float((self.vertices @ d).min())
        return float(self.T_object_part[:3, 3] @ direction) - reach


@dataclass(frozen=True)
class ObjectModel:
    """What the physics and the renderer need of an object.

    mass in kg. mesh: vertices (n, 3) m and faces (m, 3), drawn only. soft: foam, with soft contact.
    rolls: with rolling friction.
    """

    name: str
    mass: float
    parts: tuple[Part, ...]
    look: Look
    mesh: tuple[Array, NDArray[np.int32]] | None = field(default=None, repr=False)
    soft: bool = False
    rolls: bool = False

    def rest_height(self) -> float:
        """Height of the origin over the surface it stands on, m."""
        return -min(p.lowest(np.array([0.0, 0.0, 1.0])) for p in self.parts)

    def extent(self) -> Array:
        """Size (3,) of the bounding box, m."""
        reach = [-min(p.lowest(s * e) for p in self.parts) for e in np.eye(3) for s in (1.0, -1.0)]
        return np.asarray(np.array(reach).reshape(3, 2).sum(axis=1))


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, R: Array | None = None) -> Array:
    """A pose (4, 4) from a position in m and a rotation (3, 3)."""
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    if R is not None:
        T[:3, :3] = R
    return T


def box(
    name: str, size_mm: tuple[float, float, float], mass: float, look: Look, soft: bool = False
) -> ObjectModel:
    """A box of a size in mm and a mass in kg."""
    half = tuple(s / 2000 for s in size_mm)
    return ObjectModel(name, mass, (Part("box", np.eye(4), half),), look, soft=soft)


def ball(name: str, diameter: float, mass: float, look: Look) -> ObjectModel:
    """A ball of a diameter in m and a mass in kg."""
    return ObjectModel(name, mass, (Part("sphere", np.eye(4), (diameter / 2,)),), look, rolls=True)


def vessel(
    name: str,
    r_bottom: float,
    r_top: float,
    height: float,
    wall: float,
    mass: float,
    look: Look,
    handle: float = 0.0,
) -> ObjectModel:
    """An open cup: twelve wall boxes and a bottom disc, drawn as a surface of revolution.

    Lengths in m, mass in kg. handle: how far a handle of three capsules stands out, 0 for none.
    """
    n = 12
    tilt = float(np.arctan2(r_top - r_bottom, height))
    slant = float(np.hypot(height, r_top - r_bottom))
    middle = (r_bottom + r_top) / 2 - wall / 2
    parts = [Part("cylinder", at(0, 0, -height / 2 + wall / 2), (r_bottom - wall / 2, wall / 2))]
    for k in range(n):
        angle = 2 * np.pi * k / n
        R = Rotation.from_euler("ZY", [angle, tilt]).as_matrix()
        half = (wall / 2, middle * np.tan(np.pi / n) + wall / 4, slant / 2)
        parts.append(Part("box", at(middle * np.cos(angle), middle * np.sin(angle), 0, R), half))
    if handle:
        r, x, h = 0.006, (r_bottom + r_top) / 2 + handle - 0.006, height * 0.30
        parts.append(Part("capsule", at(x, 0, 0), (r, h - r)))
        inner = (r_bottom + r_top) / 2 - wall
        across = Rotation.from_euler("y", np.pi / 2).as_matrix()
        parts += [
            Part("capsule", at((x + inner) / 2, 0, z, across), (r, (x - inner) / 2))
            for z in (h, -h)
        ]
    top, bottom = height / 2, -height / 2
    profile = [
        (0, bottom),
        (r_bottom, bottom),
        (r_top, top),
        (r_top - wall, top),
        (r_bottom - wall, bottom + wall),
        (0, bottom + wall),
    ]
    return ObjectModel(name, mass, tuple(parts), look, mesh=revolve(profile, 36))


def stack(
    name: str, sections: list[tuple[float, float, float]], mass: float, look: Look
) -> ObjectModel:
    """A bottle-like solid of elliptic sections, with one convex hull between each two.

    sections: half width along x, half width along y, z, in m; mass in kg.
    """
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    low, high = sections[0][2], sections[-1][2]
    rings = [
        np.stack([a * np.cos(turn), b * np.sin(turn), np.full(24, z - (low + high) / 2)], 1)
        for a, b, z in sections
    ]
    parts = tuple(
        Part("hull", np.eye(4), vertices=np.concatenate(pair)) for pair in pairwise(rings)
    )
    return ObjectModel(name, mass, parts, look)


def revolve(profile: list[tuple[float, float]], n: int) -> tuple[Array, NDArray[np.int32]]:
    """Closed surface of revolution of a profile (radius, z) m from axis to axis.

    Returns vertices (m, 3) m and faces (k, 3).
    """
    import trimesh

    mesh = trimesh.creation.revolve(np.array(profile, dtype=float), sections=n)
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)


def ten_objects() -> dict[str, ObjectModel]:
    """The ten objects of the dynamic-grasping paper (Table III) by size and mass.

    docs/simulation.md, "Objects", lists them. Looks are ours.
    """
    bottle = [
        (0.047, 0.029, 0.0),
        (0.048, 0.029, 0.09),
        (0.042, 0.026, 0.125),
        (0.020, 0.017, 0.150),
        (0.013, 0.013, 0.160),
    ]
    bottle += [(0.010, 0.010, 0.190)]
    made = [
        box("sugar_box", (38, 89, 175), 0.514, Look("print", (225, 190, 40))),
        box("pudding_box", (35, 110, 89), 0.187, Look("print", (120, 70, 40))),
        box("gelatin_box", (28, 85, 73), 0.097, Look("print", (190, 50, 60))),
        stack("mustard_bottle", bottle, 0.603, Look("print", (235, 200, 30))),
        ball("apple", 0.075, 0.068, Look("mottled", (170, 35, 35))),
        vessel(
            "mug", 0.0465, 0.0465, 0.081, 0.004, 0.118, Look("print", (180, 45, 40)), handle=0.024
        ),
        ball("baseball", 0.073, 0.148, Look("seam", (232, 230, 222))),
        vessel("cup", 0.030, 0.0375, 0.068, 0.003, 0.025, Look("print", (60, 120, 190))),
        box("foam_brick", (50, 75, 50), 0.028, Look("mottled", (150, 60, 45)), soft=True),
        box("rubiks_cube", (57, 57, 57), 0.094, Look("tiles", (30, 30, 30))),
    ]
    return {m.name: m for m in made}


def eight_objects() -> dict[str, ObjectModel]:
    """The eight objects of VFAS-Grasp (Table I).

    Bowl, cracker box, chips can, mug, mustard and can have the YCB set's sizes. The sizes of bottle
    and small box are ours, since the paper gives none. Looks are ours.
    """
    mustard = ten_objects()["mustard_bottle"]
    bottle = [(0.033, 0.033, 0.0), (0.033, 0.033, 0.13), (0.014, 0.014, 0.17), (0.014, 0.014, 0.20)]
    made = [
        vessel("bowl", 0.045, 0.080, 0.055, 0.004, 0.147, Look("print", (190, 40, 40))),
        box("cracker_box", (60, 158, 210), 0.411, Look("print", (200, 40, 40))),
        stack("bottle", bottle, 0.35, Look("print", (60, 130, 200))),
        ObjectModel(
            "can",
            0.349,
            (Part("cylinder", np.eye(4), (0.033, 0.0505)),),
            Look("print", (190, 60, 40)),
        ),
        ObjectModel(
            "chips_can",
            0.205,
            (Part("cylinder", np.eye(4), (0.0375, 0.125)),),
            Look("print", (200, 50, 50)),
        ),
        ten_objects()["mug"],
        ObjectModel("mustard", mustard.mass, mustard.parts, mustard.look),
        box("small_box", (45, 70, 110), 0.150, Look("print", (80, 150, 90))),
    ]
    return {m.name: m for m in made}


def procedural_object(index: int, seed: int = 0) -> ObjectModel:
    """Object `index` of an endless training set, of random kind, size and mass (30 to 600 g).

    None has a size within 2 mm of one of the ten objects.
    """
    rng = generator(seed, "procedural", index)
    tested = [np.sort(m.extent()) for m in ten_objects().values()]
    while True:
        model = _random_object(index, rng)
        if all(np.abs(np.sort(model.extent()) - size).max() > 0.002 for size in tested):
            return model


def _random_object(index: int, rng: np.random.Generator) -> ObjectModel:
    """One object of a kind that follows from its index; ranges of sizes m and mass kg are ours."""
    kind = ("box", "cylinder", "ellipsoid", "capsule", "frustum", "prism", "bottle", "cup", "mug")[
        index % 9
    ]
    name, mass = f"{kind}_{index:03d}", float(rng.uniform(0.03, 0.6))
    styles: tuple[Literal["print", "mottled", "tiles"], ...] = ("print", "mottled", "tiles")
    look = Look(styles[int(rng.integers(3))], tuple(int(c) for c in rng.integers(40, 230, 3)))  # type: ignore[arg-type]
    a, b = (float(v) for v in rng.uniform(0.015, 0.045, 2))
    h = float(rng.uniform(0.02, 0.08))
    if kind == "box":
        return ObjectModel(name, mass, (Part("box", np.eye(4), (a, b, h)),), look)
    if kind == "cylinder":
        return ObjectModel(name, mass, (Part("cylinder", np.eye(4), (a, h)),), look)
    if kind == "ellipsoid":
        return ObjectModel(
            name, mass, (Part("ellipsoid", np.eye(4), (a, b, min(h, 0.05))),), look, rolls=True
        )
    if kind == "capsule":
        lying = Rotation.from_euler("x", np.pi / 2).as_matrix()
        return ObjectModel(name, mass, (Part("capsule", at(R=lying), (a, h)),), look, rolls=True)
    if kind == "frustum":
        return stack(name, [(a, b, 0.0), (a * 0.6, b * 0.6, 2 * h)], mass, look)
    if kind == "prism":
        wide = 0.02 + a
        parts = (
            Part("box", at(0, 0, -h / 2), (wide, b, h / 2)),
            Part("box", at(-wide / 2, 0, h / 2), (wide / 2, b, h / 2)),
        )
        return ObjectModel(name, mass, parts, look)
    if kind == "bottle":
        r = 0.02 + a / 2
        return stack(
            name,
            [
                (r, r, 0.0),
                (r, r, 1.4 * h),
                (0.4 * r, 0.4 * r, 1.8 * h),
                (0.4 * r, 0.4 * r, 2.2 * h),
            ],
            mass,
            look,
        )
    r = 0.025 + a / 2
    return vessel(
        name,
        0.85 * r,
        r,
        max(2 * h, 0.05),
        0.0035,
        mass,
        look,
        handle=0.022 if kind == "mug" else 0.0,
    )


def add_object(
    spec: mujoco.MjSpec, model: ObjectModel, body_name: str = "object"
) -> mujoco.MjsBody:
    """A free body with the model's parts. Parts share the mass by volume, so the total is right."""
    body = spec.worldbody.add_body(name=body_name)
    body.add_freejoint(name=body_name)
    material = add_material(
        spec, model.name if body_name == "object" else f"{body_name}_{model.name}", model.look
    )
    volumes = [p.volume() for p in model.parts]
    visible_group = OBJECT_GROUP if body_name == "object" else 0
    for k, (part, volume) in enumerate(zip(model.parts, volumes, strict=True)):
        name = f"{body_name}_{k}"
        if part.kind == "hull":
            assert part.vertices is not None
            spec.add_mesh(name=name, uservert=part.vertices.astype(np.float32).ravel())
            geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, name=name)
        else:
            geom = body.add_geom(type=GEOM[part.kind], size=[*part.size, 0, 0, 0][:3], name=name)
        place(geom, part.T_object_part)
        geom.mass = model.mass * volume / sum(volumes)
        geom.contype, geom.conaffinity = 1, 3
        geom.condim = 6 if model.rolls else 4
        # friction: sliding, torsional m, rolling m; solref: time constant s, damping ratio; ours
        geom.friction = [0.6, 0.005, 0.001 if model.rolls else 0.0001]
        geom.solref = [0.02, 1] if model.soft else [0.008, 1]
        geom.material = material
        # the hulls of a drawn mesh are not drawn
        geom.group = visible_group if model.mesh is None else 3
    if model.mesh is not None:
        vertices, faces = model.mesh
        mesh = spec.add_mesh(
            name=f"{body_name}_seen",
            uservert=vertices.astype(np.float32).ravel(),
            userface=faces.ravel(),
        )
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        shown = [body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{body_name}_seen")]
        for part in model.parts:
            if part.kind == "capsule":  # a handle is not part of the surface of revolution
                shown.append(body.add_geom(type=GEOM["capsule"], size=[*part.size, 0]))
                place(shown[-1], part.T_object_part)
        for geom in shown:
            geom.contype, geom.conaffinity, geom.mass, geom.material, geom.group = (
                0,
                0,
                0,
                material,
                visible_group,
            )
    return body


def surface_points(model: ObjectModel, n: int, rng: np.random.Generator) -> Array:
    """Points (n, 3) m on the drawn surface of the object, uniform by area, object frame."""
    return surface_with_normals(model, n, rng)[0]


def surface_with_normals(
    model: ObjectModel, n: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """The same points, and the unit normals (n, 3) that point out of the object there."""
    import trimesh

    walls, solids = _drawn(model)
    mesh = trimesh.util.concatenate([*solids, *walls])
    areas = np.cumsum(mesh.area_faces)
    batches: list[Array] = []
    normals: list[Array] = []
    while sum(map(len, batches)) < n:
        k = np.searchsorted(areas, rng.random(n) * areas[-1])
        u, v = rng.random((2, n, 1))
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
        t = mesh.triangles[k]
        points = t[:, 0] + u * (t[:, 1] - t[:, 0]) + v * (t[:, 2] - t[:, 0])
        # a step of 10 um off the surface: if it is within another part, no camera sees the point
        outside = points + 1e-5 * mesh.face_normals[k]
        hidden = np.zeros(n, bool)
        for solid in solids if len(solids) > 1 or walls else []:
            reach = (solid.face_normals * solid.triangles[:, 0]).sum(axis=1)
            hidden |= (outside @ solid.face_normals.T <= reach).all(axis=1)
        batches.append(points[~hidden])
        normals.append(mesh.face_normals[k][~hidden])
    return np.concatenate(batches)[:n], np.concatenate(normals)[:n]


def drawn_mesh(model: ObjectModel):  # type: ignore[no-untyped-def]
    """The drawn surface as one triangle mesh, object frame, m; parts may lie in one another."""
    import trimesh

    walls, solids = _drawn(model)
    return trimesh.util.concatenate([*walls, *solids])


def _drawn(model: ObjectModel):  # type: ignore[no-untyped-def]
    """Meshes of what is drawn: the model's own, and its solids or, beside a mesh, its capsules."""
    import trimesh

    solids = [_part_mesh(p) for p in model.parts if model.mesh is None or p.kind == "capsule"]
    walls = [] if model.mesh is None else [trimesh.Trimesh(*model.mesh, process=False)]
    return walls, solids


def _part_mesh(part: Part):  # type: ignore[no-untyped-def]
    """A part's surface as a triangle mesh in the object frame."""
    import trimesh

    s = part.size
    if part.kind == "hull":
        assert part.vertices is not None
        return trimesh.convex.convex_hull(transform(part.T_object_part, part.vertices))
    if part.kind == "box":
        mesh = trimesh.creation.box(2 * np.array(s))
    elif part.kind == "cylinder":
        mesh = trimesh.creation.cylinder(s[0], 2 * s[1], sections=32)
    elif part.kind == "capsule":
        mesh = trimesh.creation.capsule(2 * s[1], s[0])
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
    else:
        mesh = trimesh.creation.icosphere(3, 1.0)
        mesh.apply_scale([s[0]] * 3 if part.kind == "sphere" else s)
    return mesh.apply_transform(part.T_object_part)
