"""Perception on rendered images: the pipeline's own tracking, registration, fusion and estimation in the closed loop."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, increment, invert, transform
from dgeval.perception.pipeline import Perception
from dgeval.recording.frame import Frame
from dgeval.robots.description import Description, LinkShape, load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.simulation.perception import Sight
from dgeval.simulation.render import Eyes
from dgeval.simulation.scenario import Plan, Scenario
from dgeval.simulation.world import World
from dgeval.worlds.scene import pose_of


@dataclass(frozen=True)
class Images:
    """One frame as recorded: JPEG file, depth (H, W) in counts, mask (H, W) of the object, model points where they changed."""

    jpeg: bytes
    depth: NDArray[np.uint16]
    mask: NDArray[np.bool_] | None
    T_camera_model: Array | None = None
    model: Array | None = None


def encode(colour: NDArray[np.uint8], quality: int) -> bytes:
    """(H, W, 3) RGB as JPEG."""
    return bytes(cv2.imencode(".jpg", colour[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def look(
    index: int, t_ns: int, world: World, eyes: Eyes, hand: Description, quality: int
) -> tuple[Frame, bytes, NDArray[np.uint16]]:
    """A frame as replay will read it: colour through JPEG, depth in counts, the hand's solids; and the images to record."""
    colour, depth, _ = eyes.look(index)
    jpeg = encode(colour, quality)
    decoded = np.asarray(
        cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8
    )[:, :, ::-1]
    metres = depth.astype(np.float32) * np.float32(eyes.profile.depth_unit)
    T_base_camera = world.T_base_hand() @ world.gripper.T_hand_camera
    frame = Frame(
        index, t_ns, np.ascontiguousarray(decoded), metres, eyes.cameras[0].intrinsics, T_base_camera,
        world.T_base_palm(), hand_shapes(hand, world, T_base_camera),
    )  # fmt: skip
    return frame, jpeg, depth


class RenderedPerception:
    """Draws what the camera sees, as it is recorded, and runs the stages on it; keeps the images for the recording.

    The pipeline knows how the model moved, not what object it is; where the grasps' object frame lies in the model is told
    once, in the first accepted frame (they come from an analytic sampler, not from the cloud).
    """

    def __init__(self, scenario: Scenario, plan: Plan, eyes: Eyes) -> None:
        config = scenario.pipeline
        self._eyes, self._plan = eyes, plan
        self._perception = Perception(config.model_copy(update={"seed": plan.seed}))
        self._hand = load_description(
            robot_urdf(scenario.gripper.T_hand_camera, scenario.gripper),
            "the simulated robot",
            (),
            config.self_filter.radius_default,
        )
        self._T_model_object: Array | None = None
        self._bias = increment(np.array(plan.faults.registration_bias))
        self._started = False
        self._quality = scenario.camera.jpeg_quality
        self.kept: dict[int, Images] = {}

    def see(self, frame: int, t_ns: int, world: World) -> Sight:
        taken, jpeg, depth = look(frame, t_ns, world, self._eyes, self._hand, self._quality)
        T_base_camera = taken.T_base_camera
        assert T_base_camera is not None
        box = None
        if not self._started:
            box = self._eyes.box()
            self._started = box is not None
        camera = self._eyes.cameras[0]
        seen = self._perception.step(taken, T_base_camera, box, lambda _: None)
        mask = None
        if seen.tracked.mask is not None and seen.tracked.window is not None:
            x0, y0, x1, y1 = seen.tracked.window
            mask = np.zeros(depth.shape, dtype=bool)
            mask[y0:y1, x0:x1] = seen.tracked.mask
        fresh = seen.model is not None and (not self.kept or frame % 30 == 0)
        self.kept[frame] = Images(
            jpeg,
            depth,
            mask,
            seen.T_camera_model,
            seen.model.points if fresh and seen.model else None,
        )
        if not seen.accepted or seen.T_camera_model is None:
            return Sight(None)
        if self._T_model_object is None:
            T_camera_object = (
                invert(world.T_base_hand() @ camera.T_hand_camera) @ world.T_base_object()
            )
            self._T_model_object = invert(seen.T_camera_model) @ T_camera_object
        T = T_base_camera @ seen.T_camera_model @ self._T_model_object @ self._bias
        T[:3, 3] += np.array(self._plan.faults.tracker_drift) * world.t
        return Sight(
            T,
            None
            if seen.model is None
            else transform(T_base_camera @ seen.T_camera_model, seen.model.points),
        )


def hand_shapes(
    description: Description, world: World, T_base_camera: Array
) -> list[tuple[LinkShape, Array]]:
    """The hand's solids with T_camera_shape as the robot believes them: joints as they are, camera as calibrated."""
    T_camera_base = invert(T_base_camera)
    return [
        (shape, T_camera_base @ pose_of(world.data, link) @ shape.T_link_shape)
        for link in description.below("hand_base")
        if description.shapes.get(link)
        for shape in description.shapes[link]
    ]
