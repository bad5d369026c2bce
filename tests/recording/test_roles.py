"""Catches: a topic in the wrong role, a better candidate passed over in silence, and a role made up
where none is recorded.

`find_roles` on scans made by hand: each role by type, by name, as configured; ties; missing ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from dgeval.config import RolesConfig
from dgeval.errors import UsageError
from dgeval.geometry import Intrinsics
from dgeval.recording.containers.container import Opened, Topic
from dgeval.recording.messages import CameraModel
from dgeval.recording.roles import Roles, find_roles
from dgeval.recording.scan import ImageHead, Scan, TopicTimes

IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
CAMERA = CameraModel(Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5), "camera", ())


class Container:
    """Topics without messages."""

    kind, checksums = "memory", "none"

    def __init__(self) -> None:
        self.path = Path("made.mcap")
        self.topics: dict[str, Topic] = {}
        self.damage: list[Any] = []

    def messages(self, _topics: frozenset[str]) -> Any:
        return iter(())


def scan_of(
    images: dict[str, str] | None = None,
    *,
    cameras: tuple[str, ...] = (),
    joints: tuple[str, ...] = (),
    poses: tuple[str, ...] = (),
    counts: dict[str, int] | None = None,
) -> Scan:
    """A scan with image topics by encoding and other topics by kind; ten messages each unless
    counted otherwise.
    """
    container = Container()
    scanned = Scan(Opened(container, container.path))
    kinds = {
        **dict.fromkeys(images or {}, IMAGE),
        **dict.fromkeys(cameras, INFO),
        **dict.fromkeys(joints, "sensor_msgs/msg/JointState"),
        **dict.fromkeys(poses, "geometry_msgs/msg/PoseStamped"),
    }
    for name, kind in kinds.items():
        count = (counts or {}).get(name, 10)
        container.topics[name] = Topic(name, kind, "cdr", count, lambda data: data)
        scanned.times[name] = TopicTimes(list(range(count)), list(range(count)))
    for name, encoding in (images or {}).items():
        scanned.images[name] = ImageHead(encoding, 64, 48, "camera", encoding)
    for name in cameras:
        scanned.cameras[name] = CAMERA
    for name in joints:
        scanned.joints[name] = []
    for name in poses:
        scanned.poses[name] = []
    return scanned


def roles(scanned: Scan, **configured: str) -> Roles:
    return find_roles(scanned, RolesConfig.model_validate(configured))


# images


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "8UC3", "mono8", "8UC1"])
def test_colour_by_its_encoding(encoding: str) -> None:
    chosen = roles(scan_of({"/a": encoding, "/b": "16UC1"}))
    assert (chosen.colour, chosen.depth) == ("/a", "/b")
    assert chosen.passed_over == {}


@pytest.mark.parametrize("encoding", ["16UC1", "Z16", "32FC1"])
def test_depth_by_its_encoding(encoding: str) -> None:
    chosen = roles(scan_of({"/a": "rgb8", "/b": encoding}))
    assert (chosen.colour, chosen.depth) == ("/a", "/b")


def test_grey_of_16_bits_is_depth_by_its_name_alone() -> None:
    """Catches an infrared picture taken for depth because of its pixel format."""
    assert roles(scan_of({"/a": "rgb8", "/infra1": "mono16"})).depth is None
    assert roles(scan_of({"/a": "rgb8", "/Depth_0/image": "mono16"})).depth == "/Depth_0/image"


def test_an_image_of_another_kind_plays_no_role() -> None:
    """Catches an infrared image of 16 bits or a broken image taken for colour or depth."""
    chosen = roles(scan_of({"/a": "?", "/b": "bayer_rggb8"}))
    assert (chosen.colour, chosen.depth, chosen.intrinsics) == (None, None, None)


def test_a_picture_of_depth_is_not_colour() -> None:
    """Catches the coloured picture of a depth image, which is rgb8, in the role of colour."""
    assert roles(scan_of({"/camera/Depth/visual": "rgb8"})).colour is None


@pytest.mark.parametrize("name", ["color", "colour", "rgb", "RGB"])
def test_colour_by_its_name(name: str) -> None:
    """Catches the topic with more messages in place of the one whose name says colour."""
    other = "/a/image"
    chosen = roles(scan_of({other: "rgb8", f"/z/{name}": "rgb8"}, counts={other: 90}))
    assert chosen.colour == f"/z/{name}"
    assert chosen.passed_over == {"colour": [other]}


@pytest.mark.parametrize("name", ["infra1", "left", "right"])
def test_a_stereo_image_comes_after_another(name: str) -> None:
    chosen = roles(scan_of({f"/a/{name}": "mono8", "/z/image": "mono8"}, counts={f"/a/{name}": 90}))
    assert chosen.colour == "/z/image"


@pytest.mark.parametrize("name", ["aligned_to", "registered"])
def test_aligned_depth_comes_first(name: str) -> None:
    """Catches depth of another camera's pixels in place of that which fits the colour image."""
    images = {"/a/depth": "16UC1", f"/z/{name}": "16UC1"}
    chosen = roles(scan_of(images, counts={"/a/depth": 90}))
    assert chosen.depth == f"/z/{name}"
    assert chosen.passed_over == {"depth": ["/a/depth"]}


def test_depth_by_its_name() -> None:
    chosen = roles(scan_of({"/a/thermal": "16UC1", "/z/depth": "16UC1"}, counts={"/a/thermal": 90}))
    assert chosen.depth == "/z/depth"


def test_ties_go_to_the_most_messages_then_to_the_first_name() -> None:
    """Catches a choice by the order in the file, which another recorder changes."""
    images = {"/c/rgb": "rgb8", "/b/rgb": "rgb8", "/a/rgb": "rgb8"}
    assert roles(scan_of(images, counts={"/b/rgb": 11})).colour == "/b/rgb"
    chosen = roles(scan_of(images))
    assert chosen.colour == "/a/rgb"
    assert chosen.passed_over == {"colour": ["/b/rgb", "/c/rgb"]}
    depth = {"/c/depth": "16UC1", "/b/depth": "16UC1", "/a/depth": "16UC1"}
    assert roles(scan_of(depth, counts={"/c/depth": 11})).depth == "/c/depth"
    assert roles(scan_of(depth)).depth == "/a/depth"


@pytest.mark.parametrize(
    "name",
    ["/dgeval/rgb", "/truth/rgb", "/rgb/mask", "/rgb/debug", "/rgb/annotated", "/rgb/detections"],
)
def test_what_was_drawn_or_is_the_truth_is_no_camera(name: str) -> None:
    """Catches a replay of a picture with boxes drawn in it, and one that reads the truth."""
    assert roles(scan_of({name: "rgb8"})).colour is None
    assert roles(scan_of({name: "16UC1"})).depth is None
    assert roles(scan_of(joints=(name,), poses=(name + "_camera", name + "_hand"))) == roles(
        scan_of()
    )


def test_a_topic_without_messages_plays_no_role() -> None:
    images = {"/a/rgb": "rgb8", "/a/depth": "16UC1"}
    chosen = roles(
        scan_of(
            images, joints=("/joint_states",), counts=dict.fromkeys([*images, "/joint_states"], 0)
        )
    )
    assert (chosen.colour, chosen.depth, chosen.hand_joints) == (None, None, None)


# intrinsics


def test_intrinsics_are_those_of_the_nearest_name() -> None:
    """Catches the depth camera's intrinsics for colour, by the number of letters or by the
    alphabet.
    """
    cameras = ("/camera/depth/camera_info", "/camera/color/camera_info", "/other/camera_info")
    chosen = roles(scan_of({"/camera/color/image_raw": "rgb8"}, cameras=cameras))
    assert chosen.intrinsics == "/camera/color/camera_info"
    # none nearer than another: the first name
    chosen = roles(scan_of({"/image": "rgb8"}, cameras=("/y/camera_info", "/x/camera_info")))
    assert chosen.intrinsics == "/x/camera_info"


def test_without_colour_there_are_no_intrinsics() -> None:
    assert roles(scan_of({"/depth": "16UC1"}, cameras=("/camera_info",))).intrinsics is None
    assert roles(scan_of({"/rgb": "rgb8"})).intrinsics is None


# the robot


def test_hand_joints_by_name_then_count() -> None:
    """Catches the arm's controller state in place of joint states."""
    chosen = roles(scan_of(joints=("/a/state", "/z/joint_states"), counts={"/a/state": 90}))
    assert chosen.hand_joints == "/z/joint_states"
    assert chosen.joints == ("/z/joint_states", "/a/state"), "all of them count"
    assert roles(scan_of(joints=("/a", "/b"), counts={"/b": 11})).hand_joints == "/b"
    assert roles(scan_of(joints=("/b", "/a"))).hand_joints == "/a"


@pytest.mark.parametrize("name", ["/Camera/pose", "/cam_pose"])
def test_the_cameras_pose_by_name(name: str) -> None:
    chosen = roles(scan_of(poses=("/target", name)))
    assert (chosen.camera_pose, chosen.hand_pose) == (name, None)


@pytest.mark.parametrize("name", ["/palm", "/Hand/pose", "/gripper", "/tcp", "/ee_pose"])
def test_the_hands_pose_by_name(name: str) -> None:
    chosen = roles(scan_of(poses=("/target", name)))
    assert (chosen.camera_pose, chosen.hand_pose) == (None, name)


def test_poses_in_the_order_of_their_names() -> None:
    chosen = roles(scan_of(poses=("/tcp", "/hand", "/odom", "/camera")))
    assert (chosen.camera_pose, chosen.hand_pose) == ("/camera", "/hand")
    assert chosen.passed_over == {"hand_pose": ["/tcp"]}, "odometry is of a mobile base"


# configured, missing

ALL = ("colour", "depth", "intrinsics", "hand_joints", "camera_pose", "hand_pose")


@pytest.mark.parametrize("role", ALL)
def test_a_configured_topic_wins(role: str) -> None:
    """Catches a configured topic that is judged by its type or its name, or reported as a
    choice.
    """
    images = {"/rgb": "rgb8", "/rgb2": "rgb8", "/depth": "16UC1", "/depth2": "16UC1", "/mask": "?"}
    joints, poses = ("/joint_states", "/b"), ("/camera", "/odom", "/hand", "/tcp")
    scanned = scan_of(images, cameras=("/camera_info",), joints=joints, poses=poses)
    usual, chosen = roles(scanned), roles(scanned, **{role: "/mask"})
    for other in ALL:
        assert getattr(chosen, other) == ("/mask" if other == role else getattr(usual, other))
    assert chosen.passed_over == {k: v for k, v in usual.passed_over.items() if k != role}


@pytest.mark.parametrize("role", [*ALL, "events"])
def test_a_configured_topic_must_be_recorded(role: str) -> None:
    """Catches a typing error that is met in silence; the message names the role, and the topics
    there are.
    """
    scanned = scan_of({"/rgb": "rgb8"}, joints=("/joint_states",), counts={"/rgb": 7})
    expected = (
        f"roles.{role} = '/rbg' is not in the recording, which has: "
        "/joint_states (sensor_msgs/msg/JointState, 10); /rgb (sensor_msgs/msg/Image, 7)"
    )
    with pytest.raises(UsageError) as caught:
        roles(scanned, **{role: "/rbg"})
    assert caught.value.what == expected
    assert caught.value.exit_code == 2


def test_nothing_recorded_nothing_found() -> None:
    assert roles(scan_of()) == Roles(None, None, None, None, None, None, {})
