"""What the simulated robot believes about the object in each frame.

Here it is modelled as truth with errors, without images.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dgeval.config import Config
from dgeval.determinism import generator
from dgeval.geometry import Array, Intrinsics, increment, invert, transform
from dgeval.perception.fusion import Fusion
from dgeval.perception.types import Observation
from dgeval.simulation.clouds import seen_from
from dgeval.simulation.scenario import Plan, Scenario
from dgeval.simulation.sensors import (
    PROFILES,
    DepthProfile,
    colour_from_depth,
    colour_intrinsics,
    depth_intrinsics,
)
from dgeval.simulation.world import World
from dgeval.worlds.objects import ObjectModel, surface_points, surface_with_normals
from dgeval.worlds.scene import Camera

# Least share of the surface points on the object's near side that must lie inside the image and
# beyond the least range; ours.
MIN_SHARE = 0.35
# What of a surface becomes a part of the model, as rendered recordings show
# (benchmarks/results/modelled-cloud.md): seen at less than some 78 degrees, and so far above the
# support that the removal of the plane leaves it, or above the hand that holds it, m.
LEAST_COSINE, PLANE_M, HELD_BELOW_M = 0.20, 0.006, 0.02
SURFACE_POINTS = 8192  # of which a model is measured; ours


@dataclass(frozen=True)
class PerceivedObject:
    """One frame's result.

    T_base_object: as the robot believes it, None when registration was refused or the object is out
    of view. cloud: the model (n, 3) m of an accepted frame, base frame, where the scenario's grasps
    need one.
    """

    T_base_object: Array | None
    cloud: Array | None = None


class Perceiver(Protocol):
    """Perceives the object through the wrist camera in a frame."""

    def perceive(self, frame: int, t_ns: int, world: World) -> PerceivedObject: ...


def depth_profile(scenario: Scenario) -> DepthProfile:
    """The scenario's depth camera."""
    from dataclasses import replace

    from dgeval.errors import UsageError

    name = scenario.camera.profile
    if name not in PROFILES:
        raise UsageError(
            f"scenario: no camera profile {name!r}", hint=f"known: {', '.join(PROFILES)}"
        )
    profile = PROFILES[name]
    if scenario.camera.min_range is not None:
        profile = replace(profile, min_range=scenario.camera.min_range)
    return profile


def true_cameras(scenario: Scenario, plan: Plan) -> tuple[Camera, Camera]:
    """Colour and depth camera at their true poses: the believed pose and the hand-eye fault."""
    profile = depth_profile(scenario)
    size = scenario.camera.width, scenario.camera.height
    T_hand_true = scenario.gripper.T_hand_camera @ increment(np.array(plan.faults.hand_eye))
    return (
        Camera("colour", colour_intrinsics(profile, *size), T_hand_true),
        Camera("depth", depth_intrinsics(profile, *size), T_hand_true @ colour_from_depth(profile)),
    )


class ModelledPerception:
    """Truth through the true camera, believed through the calibrated one.

    It has bias, drift, noise and loss of the object from view. It stands in for tracking and
    registration where a trial is simulated without images.
    """

    def __init__(self, scenario: Scenario, plan: Plan, world: World) -> None:
        self._noise, self._plan = scenario.noise, plan
        self._camera = true_cameras(scenario, plan)[0]
        self._min_range = depth_profile(scenario).min_range
        self._points = surface_points(
            world.target, 200, generator(0, f"points/{world.target.name}", 0)
        )
        self._bias = increment(np.array(plan.faults.registration_bias))
        self._model: ModelledCloud | None = None
        if scenario.grasps == "ffhnet":
            intrinsics = self._camera.intrinsics
            self._model = ModelledCloud(world.target, intrinsics, scenario.pipeline, plan)

    def perceive(self, frame: int, t_ns: int, world: World) -> PerceivedObject:  # noqa: ARG002  the protocol's
        T_base_hand = world.T_base_hand()
        T_camera_object = invert(T_base_hand @ self._camera.T_hand_camera) @ world.T_base_object()
        in_camera = transform(T_camera_object, self._points)
        k = self._camera.intrinsics
        pixels = k.project(np.column_stack([in_camera[:, :2], np.maximum(in_camera[:, 2], 1e-3)]))
        inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < k.width) & (pixels[:, 1] < k.height)
        near_side = in_camera[:, 2] <= np.median(in_camera[:, 2])  # what the camera sees of it
        if (inside & (in_camera[:, 2] > self._min_range))[near_side].mean() < MIN_SHARE:
            return PerceivedObject(None)
        rng = generator(self._plan.seed, f"perception/{self._plan.index}", frame)
        noise = np.concatenate(
            [
                rng.normal(0, self._noise.position, 3),
                np.radians(rng.normal(0, self._noise.angle, 3)),
            ]
        )
        believed = T_camera_object @ self._bias @ increment(noise)
        T = T_base_hand @ world.gripper.T_hand_camera @ believed
        T[:3, 3] += np.array(self._plan.faults.tracker_drift) * world.t
        if self._model is None:
            return PerceivedObject(T)
        cloud = self._model.step(frame, T_camera_object, believed)
        return PerceivedObject(None) if cloud is None else PerceivedObject(T, transform(T, cloud))


class ModelledCloud:
    """The fused model of modelled perception: what the pipeline's own fusion makes of its frames.

    Each accepted frame's points lie where its registration has them, so the model smears, and it
    is thinned as the pipeline's is, so it forgets what is out of view.
    """

    def __init__(self, target: ObjectModel, camera: Intrinsics, config: Config, plan: Plan) -> None:
        rng = generator(0, f"model/{target.name}", 0)
        points, normals = surface_with_normals(target, SURFACE_POINTS, rng)
        low = HELD_BELOW_M if plan.presenter is not None else PLANE_M
        height = points[:, 2] - points[:, 2].min()
        seen = height > min(low, height.max() / 3)  # of a flat thing something is seen too
        self._surface, self._normals = points[seen], normals[seen]
        self._camera, self._plan = camera, plan
        self._least, self._most = config.observation.min_points, config.observation.max_points
        self._fusion = Fusion(config.fusion)

    def step(self, frame: int, T_camera_object: Array, T_camera_believed: Array) -> Array | None:
        """Model points (n, 3), object frame as believed, after one more accepted frame.

        None, and nothing merged, where the camera measures too few points for an observation.
        T_camera_object: true; T_camera_believed: as registration has it.
        """
        rng = generator(self._plan.seed, f"model/{self._plan.index}", frame)
        rows, measured = seen_from(self._surface, T_camera_object, rng)
        pixels = self._camera.project(measured)
        in_image = ((pixels >= 0) & (pixels < [self._camera.width, self._camera.height])).all(
            axis=1
        )
        normals = self._normals[rows] @ T_camera_object[:3, :3].T
        cosine = -(normals * measured).sum(axis=1) / np.linalg.norm(measured, axis=1)
        measured = measured[in_image & (cosine > LEAST_COSINE)]
        if len(measured) < self._least:
            return None
        if self._fusion.model is not None and len(measured) > self._most:
            measured = measured[np.sort(rng.permutation(len(measured))[: self._most])]
        facing = np.tile([0.0, 0.0, -1.0], (len(measured), 1))  # any will do
        self._fusion.step(Observation(measured, facing), invert(T_camera_believed), rng)
        assert self._fusion.model is not None
        return self._fusion.model.points
