"""Pictures and depth as other drivers give them, against the demo's own.

Catches: picture formats and frames of aligned depth that are refused for an untrue reason, depth
that a driver threw away taken as missing, joint positions that were wanted taken as measured.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dgeval.errors import UnreadableError
from dgeval.recording.images import decode_image
from tests.recording.recorders import (
    DEPTH,
    JOINTS,
    TYPES,
    Message,
    contents,
    depth_codes,
    header,
    opened,
    write,
)

COMPRESSED = "sensor_msgs/msg/CompressedImage"


def changed(
    messages: list[Message], topic: str, change: Callable[[Message], Message]
) -> list[Message]:
    """The messages, those of a topic changed; change gets a copy."""
    return [change([*m[:3], copy.deepcopy(m[3])]) if m[1] == topic else m for m in messages]


def compressed(like: Any, form: str, data: np.ndarray) -> Any:
    return TYPES[COMPRESSED](header=header(like), format=form, data=data.ravel())


@pytest.mark.parametrize(
    ("form", "settings"),
    [("webp", [cv2.IMWRITE_WEBP_QUALITY, 101]), ("avif", [cv2.IMWRITE_AVIF_QUALITY, 100])],
)
def test_other_formats_of_pictures(form: str, settings: list[int]) -> None:
    """Foxglove's CompressedImage may hold JPEG, PNG, WebP and AVIF."""
    rng = np.random.default_rng(3)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (60, 80, 3), np.uint8), (0, 0), 4)
    _, data = cv2.imencode(f".{form}", picture, settings)
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    head = TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="cam")
    message = TYPES[COMPRESSED](header=head, format=form, data=data.ravel())
    read = decode_image(message)
    assert read.encoding == "bgr8"
    assert np.abs(read.array.astype(int) - picture).mean() < 1.5
    with pytest.raises(ValueError, match="can't be decoded"):
        decode_image(TYPES[COMPRESSED](header=head, format=form, data=data.ravel()[:-20]))


def test_aligned_depth_under_a_frame_that_nothing_places(
    tmp_path: Path, messages: list[Message], original: list[tuple[Any, ...]]
) -> None:
    """As RealSense's first ROS drivers named it; under another topic's name it is a question."""

    def change(m: Message) -> Message:
        m[3].header.frame_id = "camera_aligned_depth_to_color_frame"
        return m

    listed = changed(messages, DEPTH, change)
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert contents(trial) == original
    assert any("taken as aligned to colour by its name" in n for n in trial.notes)
    other = [[m[0], m[1].replace("_to_color", "_to_infra1"), *m[2:]] for m in listed]
    with pytest.raises(UnreadableError, match="is not aligned to colour"):
        opened(write(tmp_path / "b.mcap", other))


def test_depth_as_jpeg_is_said_to_be_none(tmp_path: Path, messages: list[Message]) -> None:
    def change(m: Message) -> Message:
        _, data = cv2.imencode(".jpg", np.clip(depth_codes(m[3]) // 8, 0, 255).astype(np.uint8))
        name = "/camera/aligned_depth_to_color/image_raw/compressed"
        return [m[0], name, m[2], compressed(m[3], "jpeg", data)]

    with pytest.raises(
        UnreadableError, match=r"jpeg pictures of 8 bits .*, which can't hold depth"
    ):
        opened(write(tmp_path / "j.mcap", changed(messages, DEPTH, change)))


def test_a_cloud_in_place_of_depth_is_named(tmp_path: Path, messages: list[Message]) -> None:
    kind = "sensor_msgs/msg/PointCloud2"
    fields = [
        TYPES["sensor_msgs/msg/PointField"](name=n, offset=4 * i, datatype=7, count=1)
        for i, n in enumerate("xyz")
    ]

    def change(m: Message) -> Message:
        data = np.zeros(12, np.uint8)
        cloud = TYPES[kind](
            header=header(m[3]), height=1, width=1, fields=fields, is_bigendian=False,
            point_step=12, row_step=12, data=data, is_dense=True,
        )  # fmt: skip
        return [m[0], "/camera/depth/color/points", kind, cloud]

    with pytest.raises(UnreadableError, match="/points: a cloud, and only depth images are read"):
        opened(write(tmp_path / "c.mcap", changed(messages, DEPTH, change)))


def test_joint_positions_that_were_wanted_are_not_measured(
    tmp_path: Path, messages: list[Message], original: list[tuple[Any, ...]]
) -> None:
    """Before, the first topic by name gave the positions: here those that were wanted."""
    wanted = []
    for m in messages:
        if m[1] == JOINTS:
            value = copy.deepcopy(m[3])
            value.position = np.asarray(value.position) + 0.02
            wanted.append([m[0], "/desired_joint_states", m[2], value])
    trial = opened(write(tmp_path / "d.mcap", [*messages, *wanted]))
    assert contents(trial) == original
    assert not any("merged" in n for n in trial.notes)
    alone = opened(write(tmp_path / "e.mcap", [m for m in messages if m[1] != JOINTS] + wanted))
    assert any("as wanted (/desired_joint_states)" in n for n in alone.notes)
