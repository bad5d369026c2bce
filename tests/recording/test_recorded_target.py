"""Catches: what the robot's own log marks as the target passed over, taken from another camera, or
taken for the target where it marks several things.

The marks are put around the box that the demo's manifest gives.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dgeval.config import Config
from dgeval.replay.target_search import search_target
from dgeval.runs.target_told import target_note
from tests.recording.recorders import COLOUR, STORE, TYPES, Message, flat, image, of, opened, write

CAMERA = "camera_color_optical_frame"
BOX = (170.0, 70.0, 250.0, 150.0)  # px, of the second thing that is marked


@pytest.fixture(scope="module")
def unmarked(messages: list[Message]) -> list[Message]:
    """The demo without the robot's own mask."""
    return [m for m in messages if m[1] != "/dgeval/belief/mask"]


def with_marks(
    messages: list[Message], topic: str, kind: str, make: Any, every: int = 3
) -> list[Message]:
    """With a mark beside every third colour image, from the third on."""
    colours = [m for m in messages if m[1] == COLOUR]
    marks = [
        [m[0] + 1000, topic, kind, make(copy.deepcopy(m[3].header))] for m in colours[2::every]
    ]
    return [*messages, *marks]


def found(path: Path, *settings: str) -> Any:
    return search_target(opened(path, *settings), Config())


ARRAY_2D = "vision_msgs/msg/Detection2DArray"


def test_one_detection_is_the_target(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where a thing is looked for though the robot says where it is."""
    listed = with_marks(unmarked, "/detections", ARRAY_2D, lambda h: flat(h, BOX))
    trial = opened(write(tmp_path / "a.mcap", listed))
    target = search_target(trial, Config())
    assert target is not None
    assert (target.topic, target.apart_m) == ("/detections", None)
    assert target.box == pytest.approx(BOX)
    assert target.t_ns == trial.pairs[2].t_ns
    assert not trial.checks


def test_a_detection_of_another_camera_is_none(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where pixels of a head camera are looked up in the wrist's picture."""

    def elsewhere(header: Any) -> Any:
        header.frame_id = "head_camera_optical_frame"
        return flat(header, BOX)

    listed = with_marks(unmarked, "/detections", ARRAY_2D, elsewhere)
    target = found(write(tmp_path / "a.mcap", listed))
    assert target is None or target.topic is None


def test_of_several_detections_the_one_that_is_grasped(
    tmp_path: Path, unmarked: list[Message], demo: Path
) -> None:
    """Fails where the first, or the largest, of several detections is taken."""
    automatic = found(write(tmp_path / "b.mcap", unmarked))
    assert automatic is not None
    x0, y0, x1, y1 = automatic.box
    right = (x0 - 2, y0 - 2, x1 + 2, y1 + 2)
    wrong = (5.0, 5.0, 60.0, 60.0)
    boxes = [wrong, right]
    first = next(m for m in unmarked if m[1] == COLOUR)
    listed = [
        *unmarked,
        [first[0] + 1000, "/detections", ARRAY_2D, flat(copy.deepcopy(first[3].header), *boxes)],
    ]
    target = found(write(tmp_path / "a.mcap", listed))
    assert target is not None
    assert target.topic == "/detections"
    assert target.box == pytest.approx(right)


def test_a_box_in_space(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where a 3-D box is not brought into the picture: 10 cm at 0.4 m and f = 460 px is 115
    px and, at its near side, more.
    """
    pose, vector = TYPES["geometry_msgs/msg/Pose"], TYPES["geometry_msgs/msg/Vector3"]
    point, turn = TYPES["geometry_msgs/msg/Point"], TYPES["geometry_msgs/msg/Quaternion"]

    def solid(header: Any) -> Any:
        at = pose(position=point(x=0.0, y=0.0, z=0.4), orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0))
        box = of("BoundingBox3D", center=at, size=vector(x=0.1, y=0.06, z=0.02))
        one = of("Detection3D", header=header, results=[], bbox=box, id="")
        return of("Detection3DArray", header=header, detections=[one])

    listed = with_marks(unmarked, "/detections", "vision_msgs/msg/Detection3DArray", solid)
    path = write(tmp_path / "a.mcap", listed)
    target, camera = found(path), opened(path).camera
    near_m = 0.4 - 0.01
    assert target is not None
    assert target.box[2] - target.box[0] == pytest.approx(0.1 * camera.fx / near_m, rel=1e-6)
    assert target.box[3] - target.box[1] == pytest.approx(0.06 * camera.fy / near_m, rel=1e-6)
    assert (target.box[0] + target.box[2]) / 2 == pytest.approx(camera.cx)


def test_a_mask_is_the_target(tmp_path: Path, unmarked: list[Message]) -> None:
    def masked(header: Any) -> Any:
        pixels = np.zeros((240, 320), np.uint8)
        cv2.rectangle(pixels, (170, 70), (249, 149), 255, -1)
        return image(type("Like", (), {"header": header}), pixels, "mono8")

    camera = opened(write(tmp_path / "b.mcap", unmarked)).camera
    assert (camera.width, camera.height) == (320, 240), "the mask must have the picture's size"
    listed = with_marks(unmarked, "/segmentation/mask", "sensor_msgs/msg/Image", masked)
    target = found(write(tmp_path / "a.mcap", listed))
    assert target is not None
    assert (target.topic, target.box) == ("/segmentation/mask", BOX)


@pytest.mark.parametrize("name", ["/object_pose", "fp_object"])
def test_the_pose_of_an_object_finds_the_thing_there(
    tmp_path: Path, unmarked: list[Message], name: str
) -> None:
    """Fails where a pose, on a topic of its own or on /tf, is passed over, or its point taken for
    the object's size.
    """
    automatic = found(write(tmp_path / "b.mcap", unmarked))
    trial = opened(tmp_path / "b.mcap")
    frame = next(f for f in trial.frames())
    u = round((automatic.box[0] + automatic.box[2]) / 2)
    v = round((automatic.box[1] + automatic.box[3]) / 2)
    k, z = trial.camera, float(frame.depth[v, u])
    place = ((u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z)
    first = next(m for m in unmarked if m[1] == COLOUR)
    stamped = TYPES["geometry_msgs/msg/PoseStamped"](
        header=copy.deepcopy(first[3].header),
        pose=TYPES["geometry_msgs/msg/Pose"](
            position=TYPES["geometry_msgs/msg/Point"](x=place[0], y=place[1], z=place[2]),
            orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )
    made: Message = [first[0] + 1, name, "geometry_msgs/msg/PoseStamped", stamped]
    if not name.startswith("/"):
        edge = TYPES["geometry_msgs/msg/TransformStamped"](
            header=stamped.header,
            child_frame_id=name,
            transform=TYPES["geometry_msgs/msg/Transform"](
                translation=TYPES["geometry_msgs/msg/Vector3"](x=place[0], y=place[1], z=place[2]),
                rotation=stamped.pose.orientation,
            ),
        )
        beside = copy.deepcopy(edge)  # a frame that marks nothing, at another place in the picture
        beside.child_frame_id, beside.transform.translation.x = "marker", place[0] + 0.05
        kind = "tf2_msgs/msg/TFMessage"
        made = [first[0] + 1, "/tf", kind, TYPES[kind](transforms=[beside, edge])]
    target = found(write(tmp_path / "a.mcap", [*unmarked, made]))
    assert target is not None
    assert target.topic == name
    assert target.box == pytest.approx(automatic.box, abs=3)


def test_detections_that_no_definition_explains_are_a_note(
    tmp_path: Path, unmarked: list[Message]
) -> None:
    """Fails where a type that the file does not define is called damage."""
    listed = with_marks(unmarked, "/detections", ARRAY_2D, lambda h: flat(h, BOX))
    empty = write(
        tmp_path / "a.mcap",
        listed,
        lambda kind: (
            ("ros2msg", b"")
            if kind.startswith("vision_msgs")
            else ("ros2msg", STORE.generate_msgdef(kind, ros_version=2)[0].encode())
        ),
    )
    trial = opened(empty)
    assert not trial.damage
    assert any("/detections" in note for note in trial.notes)


@pytest.mark.parametrize(
    ("scale", "said"), [(2.0, "of another size"), (1 / 320, "in shares of the picture")]
)
def test_boxes_unusable_of_picture_are_told(
    tmp_path: Path, unmarked: list[Message], scale: float, said: str
) -> None:
    """Fails where a detector that ran on a larger picture, or gives shares of it, is dropped
    without a word or takes another thing.
    """
    box = tuple(v * scale for v in BOX)
    listed = with_marks(unmarked, "/detections", ARRAY_2D, lambda h: flat(h, box))
    trial = opened(write(tmp_path / "a.mcap", listed))
    target = search_target(trial, Config())
    assert target is None or target.topic is None
    assert any(said in note for note in target_note(trial, target))


def at_place(frame: str, place: tuple[float, float, float]) -> Any:
    """Makes the pose of a thing at a place, m, by the axes of a frame."""
    pose, stamped = TYPES["geometry_msgs/msg/Pose"], TYPES["geometry_msgs/msg/PoseStamped"]
    point, turn = TYPES["geometry_msgs/msg/Point"], TYPES["geometry_msgs/msg/Quaternion"]

    def make(header: Any) -> Any:
        header.frame_id = frame
        x, y, z = place
        turned = turn(x=0.0, y=0.0, z=0.0, w=1.0)
        return stamped(header=header, pose=pose(position=point(x=x, y=y, z=z), orientation=turned))

    return make


POSE = "geometry_msgs/msg/PoseStamped"


def test_poses_of_several_objects_end_in_no_error(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where several marks that hold arrays are compared as a whole: an internal error."""
    listed = with_marks(unmarked, "/object_1/pose", POSE, at_place(CAMERA, (0.0, 0.0, 0.4)))
    listed = with_marks(listed, "/object_2/pose", POSE, at_place(CAMERA, (0.1, 0.05, 0.4)))
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.roles.target == ("/object_1/pose", "/object_2/pose")
    target = search_target(trial, Config())
    assert target is not None


def test_a_pose_estimator_is_known_by_its_name_or_named(
    tmp_path: Path, unmarked: list[Message]
) -> None:
    """Fails where FoundationPose's poses are passed over, or anyone's in the camera's frame without
    a word.
    """
    make = at_place(CAMERA, (0.0, 0.0, 0.4))
    listed = with_marks(unmarked, "/foundationpose/pose", POSE, make)
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.roles.target == ("/foundationpose/pose",)
    listed = with_marks(unmarked, "/estimator/pose", POSE, make)
    trial = opened(write(tmp_path / "b.mcap", listed))
    assert trial.roles.target == ()
    assert any("--set roles.target=/estimator/pose" in note for note in trial.notes)
    listed = with_marks(unmarked, "/slam/pose", POSE, at_place("map", (0.0, 0.0, 0.4)))
    trial = opened(write(tmp_path / "c.mcap", listed))
    assert not any("/slam/pose" in note for note in trial.notes)
