"""Perception on rendered images in the closed loop.

It runs the pipeline's own tracking, registration, fusion and estimation.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, increment, invert, transform
from dgeval.perception.pipeline import Perception
from dgeval.recording.frame import Frame
from dgeval.robots.description import Description, LinkShape
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.simulation.perception import PerceivedObject
from dgeval.simulation.render import Renderer
from dgeval.simulation.scenario import Plan, Scenario
from dgeval.simulation.world import World
from dgeval.worlds.scene import pose_of


@dataclass(frozen=True)
class Images:
    """One frame as recorded.

    jpeg: colour as a file. depth (H, W) in counts. mask (H, W) of the object. T_camera_model: the
    tracked model's pose. model (n, 3) m: its points, where they changed.
    """

    jpeg: bytes
    depth: NDArray[np.uint16]
    mask: NDArray[np.bool_] | None
    T_camera_model: Array | None = None
    model: Array | None = None


def encode(colour: NDArray[np.uint8], quality: int) -> bytes:
    """(H, W, 3) RGB as JPEG."""
    return bytes(cv2.imencode(".jpg", colour[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def camera_frame(
    index: int, t_ns: int, world: World, renderer: Renderer, hand: Description, quality: int
) -> tuple[Frame, bytes, NDArray[np.uint16]]:
    """A frame as replay will read it, and the images to record.

    The frame has colour through JPEG, depth in m from counts, and the hand's solids. The images are
    a JPEG file and depth (H, W) in counts.
    """
    colour, depth, _ = renderer.images(index)
    jpeg = encode(colour, quality)
    decoded = np.asarray(
        cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8
    )[:, :, ::-1]
    metres = depth.astype(np.float32) * np.float32(renderer.profile.depth_unit)
    T_base_camera = world.T_base_hand() @ world.gripper.T_hand_camera
    frame = Frame(
        index,
        t_ns,
        np.ascontiguousarray(decoded),
        metres,
        renderer.cameras[0].intrinsics,
        T_base_camera,
        world.T_base_palm(),
        hand_shapes(hand, world, T_base_camera),
    )
    return frame, jpeg, depth


class RenderedPerception:
    """Draws what the camera sees, as it is recorded, and runs the stages on it.

    It keeps the images for the recording. The pipeline knows how the model moved, not what object
    it is. The pose of the grasps' object frame in the model is given to it once, in the first
    accepted frame: the grasps come from an analytic sampler, not from the cloud.
    """

    def __init__(self, scenario: Scenario, plan: Plan, renderer: Renderer) -> None:
        config = scenario.pipeline
        self._renderer, self._plan = renderer, plan
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

    def perceive(self, frame: int, t_ns: int, world: World) -> PerceivedObject:
        image_frame, jpeg, depth = camera_frame(
            frame, t_ns, world, self._renderer, self._hand, self._quality
        )
        T_base_camera = image_frame.T_base_camera
        assert T_base_camera is not None
        box = None
        if not self._started:
            box = self._renderer.box()
            self._started = box is not None
        camera = self._renderer.cameras[0]
        step = self._perception.step(image_frame, T_base_camera, box, lambda _: None)
        mask = None
        if step.tracked.mask is not None and step.tracked.window is not None:
            x0, y0, x1, y1 = step.tracked.window
            mask = np.zeros(depth.shape, dtype=bool)
            mask[y0:y1, x0:x1] = step.tracked.mask
        fresh = step.model is not None and (not self.kept or frame % 30 == 0)
        self.kept[frame] = Images(
            jpeg,
            depth,
            mask,
            step.T_camera_model,
            step.model.points if fresh and step.model else None,
        )
        if not step.accepted or step.T_camera_model is None:
            return PerceivedObject(None)
        if self._T_model_object is None:
            T_camera_object = (
                invert(world.T_base_hand() @ camera.T_hand_camera) @ world.T_base_object()
            )
            self._T_model_object = invert(step.T_camera_model) @ T_camera_object
        T = T_base_camera @ step.T_camera_model @ self._T_model_object @ self._bias
        T[:3, 3] += np.array(self._plan.faults.tracker_drift) * world.t
        return PerceivedObject(
            T,
            None
            if step.model is None
            else transform(T_base_camera @ step.T_camera_model, step.model.points),
        )


def hand_shapes(
    description: Description, world: World, T_base_camera: Array
) -> list[tuple[LinkShape, Array]]:
    """The hand's solids with T_camera_shape (4, 4) as the robot believes them.

    Joints are as they are, the camera is as calibrated.
    """
    T_camera_base = invert(T_base_camera)
    return [
        (shape, T_camera_base @ pose_of(world.data, link) @ shape.T_link_shape)
        for link in description.below("hand_base")
        if description.shapes.get(link)
        for shape in description.shapes[link]
    ]
