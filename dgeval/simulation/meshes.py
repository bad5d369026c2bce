"""Users' meshes as objects: convex parts for contact by decomposition; the mesh itself is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dgeval.config import read_toml
from dgeval.errors import Place, UsageError
from dgeval.worlds.objects import ObjectModel, Part
from dgeval.worlds.textures import Look

SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
# kg/m^3 where masses.toml gives no mass; ours: boxes and bottles, between foam and water
DENSITY = 300.0
MIN_SIZE, MAX_SIZE = 0.01, 0.5  # m, between which a hand can grasp; ours


def load_meshes(folder: Path) -> dict[str, ObjectModel]:
    """Each mesh file of a folder by its stem, z up, metres.

    `masses.toml` may give masses in kg by stem. UsageError names the file.
    """
    import trimesh

    files = (
        sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
        if folder.is_dir()
        else []
    )
    if not files:
        raise UsageError(f"no meshes ({', '.join(SUFFIXES)}) in this folder", Place(str(folder)))
    masses = read_toml(folder / "masses.toml") if (folder / "masses.toml").is_file() else {}
    out = {}
    for path in files:
        try:
            mesh = trimesh.load(path, force="mesh")
            vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
        except Exception as error:
            raise UsageError(
                f"not a mesh ({type(error).__name__}: {error})", Place(str(path))
            ) from error
        size = np.ptp(vertices, axis=0) if len(vertices) else np.zeros(3)
        if not (np.isfinite(size).all() and MIN_SIZE < size.max() < MAX_SIZE):
            message = (
                f"its size is {np.round(size, 4).tolist()} m; "
                f"a hand needs {MIN_SIZE} to {MAX_SIZE} m"
            )
            raise UsageError(
                message,
                Place(str(path)),
                "meshes are in metres: scale those in millimetres by 0.001",
            )
        vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        pieces = trimesh.decomposition.convex_decomposition(mesh, maxConvexHulls=16)
        hulls = [np.asarray(p["vertices"], dtype=np.float64) for p in pieces]
        parts = tuple(
            Part("hull", np.eye(4), vertices=h)
            for h in hulls
            if len(h) >= 4 and np.linalg.matrix_rank(h - h[0]) == 3
        )
        mass = float(masses.get(path.stem, DENSITY * sum(p.volume() for p in parts)))
        look = Look("print", (150, 150, 150))
        out[path.stem] = ObjectModel(
            path.stem, mass, parts, look, mesh=(vertices, faces.astype(np.int32))
        )
    return out
