"""Clouds of an object as replay sees them: partial views of a depth camera, alone or fused, as basis point encodings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgeval.determinism import generator
from dgeval.geometry import Array, increment, invert, transform
from dgeval.networks.bps import basis, encode
from dgeval.simulation.clouds import seen_from
from dgeval.worlds.objects import ObjectModel, surface_points

MOST_TILT = np.radians(75)  # of a camera on a hand that comes from aslant
POINTS = 1500  # of a cloud; replay's have up to 4096, which moves distances by less than the noise


@dataclass(frozen=True)
class View:
    """bps (n,) m of a centred cloud; T_view_object (4, 4): origin at the cloud's mean, z down by 75 degrees or less."""

    bps: NDArray[np.float32]
    T_view_object: Array


def camera_at(tilt: float, heading: float, rng: np.random.Generator) -> Array:
    """T_camera_object of a camera so many rad from straight above an upright object, looking at it from 0.25 to 0.6 m."""
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    R_object_camera = Rotation.from_rotvec(tilt * axis).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    T = np.eye(4)
    T[:3, :3] = R_object_camera @ Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix()
    T[:3, 3] = rng.normal(0, 0.02, 3) - rng.uniform(0.25, 0.6) * T[:3, 2]
    return invert(T)


def cloud_of(surface: Array, fused: bool, rng: np.random.Generator) -> tuple[Array, Array]:
    """A cloud (m, 3) and T_cloud_object; `fused`: of up to eight views of an approach.

    An approach begins above the object and comes down to the side from which it is seen last. The axes are those of a third
    camera: weights that had learned upright clouds alone knew 63 objects and no others (AUC 0.54 of their choices, not 0.80).
    """
    tilt, heading = MOST_TILT * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
    T_cloud_object = np.eye(4)
    T_cloud_object[:3, :3] = camera_at(
        MOST_TILT * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi), rng
    )[:3, :3]
    T = camera_at(tilt, heading, rng)
    clouds = [transform(T_cloud_object @ invert(T), seen_from(surface, T, rng)[1])]
    if fused:
        for _ in range(int(rng.integers(1, 8))):
            # from elsewhere, registered with an error of a millimetre or two
            other = camera_at(tilt * rng.random(), heading + rng.normal(0, 0.4), rng)
            error = increment(
                np.concatenate([rng.normal(0, 0.0015, 3), rng.normal(0, np.radians(1), 3)])
            )
            clouds.append(
                transform(T_cloud_object @ error @ invert(other), seen_from(surface, other, rng)[1])
            )
    cloud = np.concatenate(clouds)
    return cloud[rng.permutation(len(cloud))[:POINTS]], T_cloud_object


def views_of(thing: ObjectModel, n: int, n_bps: int, seed: int) -> list[View]:
    """n views of an object, every other one fused."""
    surface = surface_points(thing, 12_000, generator(seed, f"surface/{thing.name}", 0))
    out = []
    for k in range(n):
        cloud, T_cloud_object = cloud_of(
            surface, k % 2 == 1, generator(seed, f"view/{thing.name}", k)
        )
        mean = cloud.mean(axis=0)
        T_view_object = T_cloud_object.copy()
        T_view_object[:3, 3] -= mean
        out.append(View(encode(cloud - mean, basis(n_bps)), T_view_object))
    return out
