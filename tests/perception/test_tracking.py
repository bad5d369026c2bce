"""Catches: a hand fused into the target, drift, a track that goes on after its target has left.

Also a pose without depth, and a window's coordinates taken for the image's. Tracking and fusion run
on rendered frames with exact ground truth.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.geometry import Intrinsics, increment, invert, rotation_angle
from dgeval.perception import align
from dgeval.perception.pipeline import Perception, _fuse
from dgeval.perception.segmentation import points_of
from dgeval.perception.trackers import model as model_tracker
from dgeval.perception.trackers.model import ModelTracker, TrackingInput
from dgeval.perception.types import Model, Observation, Registration, Tracked
from dgeval.recording.choices import RecordedChoices
from dgeval.recording.frame import Frame
from dgeval.replay.causal import Step, replay
from dgeval.robots.description import LinkShape
from scipy.spatial.transform import Rotation

from raycast import Box, Capsule, Scene, add_noise, printed, render, speckle

CAMERA = Intrinsics(320, 240, 290.0, 290.0, 160.0, 120.0)
HALF = (0.05, 0.035, 0.04)
PERIOD_NS = 33_333_333


def at(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    """Pose (4, 4) with a position m and a yaw rad."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0, 0, yaw]).as_matrix()
    T[:3, 3] = (x, y, z)
    return T


# looking down at the table, a little tilted
T_BASE_CAMERA = at(0, 0, 0.6) @ np.vstack(
    [
        np.hstack([Rotation.from_rotvec([np.pi - 0.35, 0, 0]).as_matrix(), np.zeros((3, 1))]),
        [0, 0, 0, 1],
    ]
)


def world(seed: int = 0) -> tuple[Scene, Box]:
    """A speckled table and a printed box."""
    rng = np.random.default_rng(seed)
    return Scene(speckle(rng, (120, 110, 100), 14)), Box(
        HALF, [printed(rng, (60, 110, 170)) for _ in range(6)]
    )


def make(
    n: int, path: Any, hand: Any = None, no_depth: Any = lambda k: False
) -> tuple[list[Frame], list[tuple[float, ...]]]:
    """Frames of a box under a resting camera, and its true visible boxes px.

    path(k): T_base_object in frame k. hand(k): T_base_finger, or None for no finger. no_depth(k):
    whether the box has no depth.
    """
    rng = np.random.default_rng(1)
    scene, box = world()
    frames, boxes = [], []
    for k in range(n):
        scene.solids = [(box, path(k))]
        shapes = None
        if hand is not None:
            scene.solids.append((Capsule(0.012, 0.05, (90, 90, 95)), hand(k)))
            shape = LinkShape("finger", "capsule", np.eye(4), (0.012, 0.05), bound=0.062)
            shapes = [(shape, invert(T_BASE_CAMERA) @ hand(k))]
        colour, depth, ids = render(scene, CAMERA, T_BASE_CAMERA)
        v, u = np.nonzero(ids == 0)
        boxes.append(
            (float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1))
            if len(u)
            else (0, 0, 0, 0)
        )
        colour, millimetres = add_noise(rng, colour, depth)
        metres = millimetres.astype(np.float32) * np.float32(0.001)
        if no_depth(k):
            metres[ids == 0] = 0.0
        frames.append(
            Frame(k, 10**15 + k * PERIOD_NS, colour, metres, CAMERA, T_BASE_CAMERA, None, shapes)
        )
    return frames, boxes


def run(frames: list[Frame], box: tuple[float, ...], *settings: str) -> list[Step]:
    trial: Any = SimpleNamespace(
        robot=SimpleNamespace(
            description=None,
            hand=None,
            base_frame="base",
            T_base_palm=lambda _: None,
            palm_stamps=lambda _: [],
        ),
        spec=SimpleNamespace(bbox=box, bbox_time_ns=None),
        event_ns=lambda _: None,
        frames=lambda: iter(frames),
        pairs=[SimpleNamespace(t_ns=frame.t_ns) for frame in frames],
        scan=SimpleNamespace(poses={}),
        choices=RecordedChoices(),
    )
    return list(replay(trial, load_config("dynamic", ("grasps.source=none", *settings))))


def slide(k: int) -> np.ndarray:
    """T_base_object (4, 4) in frame k: 4 mm and 0.01 rad a frame."""
    return at(-0.08 + 0.004 * k, -0.2, HALF[2], 0.4 + 0.01 * k)


@pytest.fixture(scope="module")
def sliding() -> tuple[list[Frame], list[tuple[float, ...]], list[Step]]:
    frames, boxes = make(30, slide)
    return frames, boxes, run(frames, boxes[0])


def test_pose_follows_a_sliding_and_turning_box(sliding: Any) -> None:
    """Catches a pose that drifts against the box's true pose."""
    _, _, steps = sliding
    T_model_objects = []
    for k, step in enumerate(steps):
        assert step.T_camera_model is not None
        T_model_object = invert(step.T_camera_model) @ invert(T_BASE_CAMERA) @ slide(k)
        T_model_objects.append(T_model_object)
    middle = T_model_objects[15]
    assert np.median([np.linalg.norm(T[:3, 3] - middle[:3, 3]) for T in T_model_objects]) < 0.0015
    assert (
        np.degrees(
            np.median([rotation_angle(middle[:3, :3].T @ T[:3, :3]) for T in T_model_objects])
        )
        < 1.2
    )


def test_boxes_are_those_of_the_target(sliding: Any) -> None:
    """Catches boxes of another object or size: mean overlap (IoU) of at most 0.9."""
    _, boxes, steps = sliding
    overlaps = []
    for step, b in zip(steps, boxes, strict=True):
        a = step.tracked.box
        assert a is not None
        w, h = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
        overlaps.append(
            w * h / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - w * h)
        )
    assert np.mean(overlaps) > 0.9


def test_velocity_is_the_slide(sliding: Any) -> None:
    """Catches a velocity in the wrong frame or unit: 4 mm a frame at 30 Hz are 0.12 m/s."""
    last = sliding[2][-1].row
    assert last["velocity_x"] == pytest.approx(0.12, abs=0.02)
    assert abs(last["velocity_y"]) < 0.02


def test_the_model_stays_the_size_of_the_box(sliding: Any) -> None:
    """Catches a model cloud that drift or the table has made larger than the box."""
    model = sliding[2][-1].model
    assert model is not None
    T = invert(invert(sliding[2][0].T_camera_model) @ invert(T_BASE_CAMERA) @ slide(0))
    local = model.points @ T[:3, :3].T + T[:3, 3]
    assert (np.abs(local) - np.array(HALF)).max() < 0.008


def finger(k: int) -> np.ndarray:
    """T_base_finger (4, 4): upright, touching the box and hiding a part of it from the camera."""
    T = slide(k)
    return T @ at(0.0, HALF[1] + 0.013, 0.03)


def share_on_finger(points_camera: np.ndarray, k: int) -> float:
    """Share of points (n, 3) m, camera frame, on the finger's surface away from the box."""
    T = invert(finger(k)) @ T_BASE_CAMERA
    p = points_camera @ T[:3, :3].T + T[:3, 3]
    axial = np.maximum(np.abs(p[:, 2]) - 0.05, 0)
    distance = np.abs(np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + axial**2) - 0.012)
    return float(((distance < 0.003) & (p[:, 1] > -0.005)).mean())


def test_a_touching_finger_is_not_part_of_the_target() -> None:
    """Catches a finger in the first frame's mask or in the model after some frames.

    Without the finger's geometry it is a part of both.
    """
    frames, boxes = make(8, slide, hand=finger)
    x0, y0, x1, y1 = boxes[0]
    box = (x0 - 4, y0 - 4, x1 + 4, y1 + 12)
    for known, bound in ((True, lambda share: share < 0.01), (False, lambda share: share > 0.02)):
        shown = frames if known else [Frame(**{**f.__dict__, "hand": None}) for f in frames]
        tracked = ModelTracker(load_config()).step(
            TrackingInput(shown[0], box, None, None, None, False)
        )
        assert tracked.mask is not None
        assert tracked.window is not None
        window = tracked.window
        depth = shown[0].depth[window[1] : window[3], window[0] : window[2]]
        assert bound(share_on_finger(points_of(depth, window, tracked.mask, CAMERA), 0))
        steps = run(shown, box)
        model, T = steps[-1].model, steps[-1].T_camera_model
        assert model is not None
        assert T is not None
        assert bound(share_on_finger(model.points @ T[:3, :3].T + T[:3, 3], len(frames) - 1))


def test_a_box_that_leaves_is_lost_and_stays_lost() -> None:
    """Catches a track that goes on, or comes back, after the box has left the image."""
    frames, boxes = make(26, lambda k: at(0.05 + 0.016 * k, -0.2, HALF[2]))
    states = [s.row["tracking"] for s in run(frames, boxes[0])]
    assert states[:8] == ["tracked"] * 8
    first = states.index("lost")
    assert set(states[first:]) == {"lost"}


def test_without_depth_the_box_is_followed_and_no_pose_is_made_up() -> None:
    """Catches a box that is lost without depth, and a pose or velocity given nevertheless."""
    frames, boxes = make(14, slide, no_depth=lambda k: True)
    steps = run(frames, boxes[0])
    assert all(s.row["tracking"] == "tracked" for s in steps)
    assert all(s.row.get("model_px") is None and s.row.get("velocity_x") is None for s in steps)
    assert np.abs(np.array(steps[-1].tracked.box) - np.array(boxes[-1])).max() < 8


def test_what_comes_too_near_for_depth_is_followed_in_colour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fails where a target is lost with its depth, as none of its own colours tells it apart, and
    the features of its model are of other views.
    """
    whole = align.align_to_image
    monkeypatch.setattr(model_tracker, "look_alikes", lambda *_: [])
    monkeypatch.setattr(align, "align_to_image", lambda *given: (*whole(*given)[:3], 0))
    frames, boxes = make(20, slide, no_depth=lambda k: k >= 8)
    steps = run(frames, boxes[0])
    assert all(s.tracked.state == "tracked" for s in steps)
    for step, box in zip(steps[8:], boxes[8:], strict=True):
        assert step.tracked.T_camera_model is None
        assert step.tracked.box is not None
        assert np.abs(np.array(step.tracked.box) - np.array(box)).max() < 8
    # with depth of other things in its box nothing says that it is there still
    for frame in frames[12:]:
        frame.depth[frame.depth == 0] = 0.65
    assert [s.tracked.state for s in run(frames, boxes[0])[12:]] == ["lost"] * 8


def test_a_gap_in_the_frames_is_bridged_by_the_velocity() -> None:
    """Catches a prediction that does not use the elapsed time: ten frames are missing."""
    frames, boxes = make(30, slide)
    steps = run([f for f in frames if not 12 <= f.index < 22], boxes[0])
    after = steps[12]
    assert after.row["tracking"] == "tracked"
    assert after.row["icp_accepted"]


def test_a_box_that_turns_ever_faster_keeps_its_sides() -> None:
    """Fails where the last pose is where the next is looked for: from 4 rad/s on, 8 degrees a
    frame, the gate refuses, and a box is soon taken for one that is turned by 10 degrees.
    """

    def turning(k: int) -> np.ndarray:
        t, gain, most = k / 30, 4.0, 6.0  # s, rad/s^2, rad/s
        angle = gain * t * t / 2 if gain * t < most else most * (t - most / gain / 2)
        T = at(0.0, -0.2, HALF[2] + 0.15)
        T[:3, :3] = Rotation.from_rotvec(np.array([0.35, 0.25, 0.9]) * angle).as_matrix()
        return T

    frames, boxes = make(48, turning)
    steps = run(frames, boxes[0])
    first = invert(T_BASE_CAMERA) @ turning(0)
    wrong = []
    for k, step in enumerate(steps):
        assert step.T_camera_model is not None
        T_model, T_camera_object = step.T_camera_model @ first, invert(T_BASE_CAMERA) @ turning(k)
        wrong.append(np.degrees(rotation_angle(T_model[:3, :3].T @ T_camera_object[:3, :3])))
    assert np.median(wrong[32:]) < 6.0


def test_a_turn_that_is_not_steady_is_not_carried_on() -> None:
    """Fails where the jitter of a small thing's pose is taken for its turn."""
    perception = Perception(load_config("dynamic", ()))
    rng = np.random.default_rng(0)
    turns = []
    for k in range(40):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.05, 3)).as_matrix()
        perception.T_prior = T
        perception.learn_turn(k * PERIOD_NS, np.eye(4), True)
        turns.append(float(np.linalg.norm(perception.turn)))
    assert np.mean(np.array(turns) > 0) < 0.35
    steady = Rotation.from_rotvec([0.0, 0.0, 0.1])
    for k in range(40, 45):
        T[:3, :3] = steady.as_matrix() @ T[:3, :3]
        perception.T_prior = T.copy()
        perception.learn_turn(k * PERIOD_NS, np.eye(4), True)
    assert perception.turn == pytest.approx([0.0, 0.0, 3.0], abs=0.01)
    perception.learn_turn(45 * PERIOD_NS, np.eye(4), False)
    assert not perception.turn.any(), "what is not seen is not known to turn on"


@pytest.mark.parametrize("has_depth", [True, False])
def test_what_colours_alone_say_carries_nothing(sliding: Any, has_depth: bool) -> None:
    """Fails where a target without depth goes on from where a dozen corners put it, 12 mm off."""
    frames, _, _ = sliding
    perception = Perception(load_config("dynamic", ()))
    perception.T_prior = perception.T_carried = np.eye(4)
    perception.fusion.model = Model(np.eye(3), np.eye(3))
    found, carried = increment(np.array([0.012, 0, 0, 0, 0, 0])), np.eye(4)
    seen = Observation(np.zeros((9, 3)), np.zeros((9, 3))) if has_depth else None
    tracked = Tracked("tracked", T_camera_model=found)
    refused = Registration(found, 0.1, 0.1, 0.01, "fitness") if has_depth else None
    _fuse(perception, frames[0], tracked, seen, refused, (np.eye(4), carried), perception.config)
    assert perception.T_prior is found, "the best place to look from next"
    assert perception.T_camera_model is carried
    assert perception.T_carried is (found if has_depth else carried)


def test_frames_are_merged_as_the_robot_merged_them(sliding: Any) -> None:
    """Fails where the gate overrules the robot's own word, which alone is asked for."""
    frames, boxes, _ = sliding
    flagged = [replace(f, accepted=f.index % 3 != 1) for f in frames[:12]]
    steps = run(flagged, boxes[0], "registration.accept=recorded", "registration.c_a_f=0.999999")
    assert [s.accepted for s in steps] == [f.index % 3 != 1 for f in flagged]
    assert {s.row["icp_reject_reason"] for s in steps if not s.accepted} == {"recorded"}
    unsaid = run(frames[:6], boxes[0], "registration.accept=recorded")
    assert all(s.accepted for s in unsaid), "where nothing is said the gate decides"
