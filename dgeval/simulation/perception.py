"""What the simulated robot believes about the object in each frame.

Here it is modelled as truth with errors, without images.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dgeval.determinism import generator
from dgeval.geometry import Array, increment, invert, transform
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
from dgeval.worlds.objects import ObjectModel, surface_points
from dgeval.worlds.scene import Camera

# Least share of the surface points on the object's near side that must lie inside the image and
# beyond the least range; ours.
MIN_SHARE = 0.35


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
            self._model = ModelledCloud(
                world.target, scenario.pipeline.fusion.max_model_points, plan
            )

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
        T = (
            T_base_hand
            @ world.gripper.T_hand_camera
            @ T_camera_object
            @ self._bias
            @ increment(noise)
        )
        T[:3, 3] += np.array(self._plan.faults.tracker_drift) * world.t
        return PerceivedObject(
            T,
            None if self._model is None else transform(T, self._model.step(frame, T_camera_object)),
        )


class ModelledCloud:
    """The fused model of modelled perception.

    It holds the parts of the surface that the camera has seen so far, as first measured.
    """

    def __init__(self, target: ObjectModel, most: int, plan: Plan) -> None:
        self._surface = surface_points(target, 2 * most, generator(0, f"model/{target.name}", 0))
        self._most, self._plan = most, plan
        self._points = np.empty((0, 3))
        self._known = np.zeros(len(self._surface), bool)

    def step(self, frame: int, T_camera_object: Array) -> Array:
        """Model points (n, 3), object frame, after one more frame."""
        rng = generator(self._plan.seed, f"model/{self._plan.index}", frame)
        rows, measured = seen_from(self._surface, T_camera_object, rng)
        new = ~self._known[rows]
        self._known[rows] = True
        self._points = np.concatenate(
            [self._points, transform(invert(T_camera_object), measured[new])]
        )
        if len(self._points) > self._most:
            self._points = self._points[np.sort(rng.permutation(len(self._points))[: self._most])]
        return self._points
