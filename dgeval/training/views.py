"""Clouds of an object as replay sees them: partial views of a depth camera, alone or fused, as basis point encodings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgeval.determinism import generator
from dgeval.geometry import Array, increment, invert, transform
from dgeval.networks.bps import basis, encode
from dgeval.physics.objects import ObjectModel, surface_points
from dgeval.simulation.clouds import seen_from

POINTS = 1500  # of a cloud; replay's have up to 4096, which moves distances by less than the noise


@dataclass(frozen=True)
class View:
    """bps (n,) m of a centred cloud; T_view_object (4, 4): origin at the cloud's mean, axes of the camera."""

    bps: NDArray[np.float32]
    T_view_object: Array


def random_camera(rng: np.random.Generator, most_tilt: float = 55.0) -> Array:
    """T_camera_object of a camera above an upright object, looking at it from 0.25 to 0.6 m, at most so many degrees aslant."""
    tilt, heading = np.radians(most_tilt) * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    R_object_camera = Rotation.from_rotvec(tilt * axis).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    T = np.eye(4)
    T[:3, :3] = R_object_camera @ Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix()
    T[:3, 3] = rng.normal(0, 0.02, 3) - rng.uniform(0.25, 0.6) * T[:3, 2]
    return invert(T)


def cloud_of(surface: Array, fused: bool, rng: np.random.Generator) -> tuple[Array, Array]:
    """A cloud (m, 3) in the axes of its last camera, and T_camera_object; `fused`: of up to five views of an approach."""
    T = random_camera(rng)
    clouds = [seen_from(surface, T, rng)[1]]
    if fused:
        for _ in range(int(rng.integers(1, 5))):
            # from elsewhere, registered with an error of a millimetre or two
            other = T @ increment(np.concatenate([rng.normal(0, 0.03, 3), rng.normal(0, np.radians(15), 3)]))
            other[2, 3] = max(other[2, 3], 0.2)
            error = increment(np.concatenate([rng.normal(0, 0.0015, 3), rng.normal(0, np.radians(1), 3)]))
            clouds.append(transform(error @ T @ invert(other), seen_from(surface, other, rng)[1]))
    cloud = np.concatenate(clouds)
    return cloud[rng.permutation(len(cloud))[:POINTS]], T


def views_of(thing: ObjectModel, n: int, n_bps: int, seed: int) -> list[View]:
    """n views of an object, every other one fused."""
    surface = surface_points(thing, 12_000, generator(seed, f"surface/{thing.name}", 0))
    out = []
    for k in range(n):
        cloud, T_camera_object = cloud_of(surface, k % 2 == 1, generator(seed, f"view/{thing.name}", k))
        mean = cloud.mean(axis=0)
        T_view_object = T_camera_object.copy()
        T_view_object[:3, 3] -= mean
        out.append(View(encode(cloud - mean, basis(n_bps)), T_view_object))
    return out
