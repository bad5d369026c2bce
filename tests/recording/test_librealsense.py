"""Catches: arrival taken for the frame's time, and the depth unit that stands beside, in the .db3
of librealsense from SDK 2.58 on. The layout is that of a file which its own recorder wrote.
"""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
from dgeval.recording.containers.opening import open_container
from dgeval.recording.scan import scan
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    INFO,
    TYPES,
    Message,
    contents,
    depth_codes,
    image,
    opened,
    write,
)

STRING = "std_msgs/msg/String"
STREAMS = {
    COLOUR: "/device_0/sensor_1/Color_0/image/",
    DEPTH: "/device_0/sensor_0/Depth_0/image/",
}


def recorded(messages: list[Message], lost: int | None = None) -> list[Message]:
    """The demo as librealsense writes it: stamps are arrivals, 7 ms late and unsteady. lost: the
    metadata of this colour image are missing.
    """
    rng = np.random.default_rng(1)
    first = min(m[0] for m in messages)
    unit = TYPES[STRING](data="0.000500")
    out = [[first, "/device_0/sensor_0/option/Depth_Units/value", STRING, unit]]
    seen = dict.fromkeys(STREAMS, 0)
    for log_ns, topic, kind, value in messages:
        if topic == INFO:
            out.append([log_ns, STREAMS[COLOUR] + "camera_info", kind, value])
        if topic not in STREAMS:
            if topic != INFO:
                out.append([log_ns, topic, kind, value])
            continue
        stamp = value.header.stamp
        own_ms = (stamp.sec * 10**9 + stamp.nanosec) * 1e-6
        value = copy.deepcopy(value)
        arrived = log_ns - first + 7_000_000 + int(rng.integers(0, 4_000_000))
        value.header.stamp.sec, value.header.stamp.nanosec = arrived // 10**9, arrived % 10**9
        if topic == DEPTH:
            codes = depth_codes(value) * 2
            kind, value = "sensor_msgs/msg/Image", image(value, codes, "16UC1")
        if topic != COLOUR or seen[topic] != lost:
            text = (
                f"Frame number={seen[topic]};timestamp_domain=Global Time;timestamp={own_ms:.6f};"
            )
            out.append([log_ns, STREAMS[topic] + "metadata", STRING, TYPES[STRING](data=text)])
        seen[topic] += 1
        out.append([log_ns, STREAMS[topic] + "data", kind, value])
    return out


def test_the_frames_own_times_and_the_unit_count(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the delays of the bus become time, or depth is twice as far."""
    trial = opened(write(tmp_path / "a.mcap", recorded(messages)))
    plain = opened(write(tmp_path / "b.mcap", messages))
    assert not trial.checks
    # the text has them in ms with six decimals, of which a double holds some 0.2 us
    apart = [a.t_ns - b.t_ns for a, b in zip(trial.pairs, plain.pairs, strict=True)]
    assert max(map(abs, apart)) < 1000
    for got, want in zip(contents(trial), contents(plain), strict=True):
        assert got[1] == want[1]
        assert got[2] == pytest.approx(want[2], rel=1e-5)


def test_with_a_time_missing_the_stamps_stay(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where two clocks are mixed in one stream."""
    made = recorded(messages, lost=5)
    found = scan(open_container(write(tmp_path / "a.mcap", made)))
    header, _ = found.times[STREAMS[COLOUR] + "data"].arrays()
    assert header.max() < 10**10


def test_streams_of_a_bag_are_not_one_camera(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where depth of a .bag is taken for aligned, since all frames of a group have one name,
    or its poses for their inverse: as librealsense writes a turned, shifted colour camera.

    There a point (0.1, 0.2, 1) m of the depth camera is at (0.0514296, 0.2406193, 0.99) m in
    colour, by its own rs2_transform_point_to_point.
    """
    quaternion = TYPES["geometry_msgs/msg/Quaternion"]
    vector, kind = TYPES["geometry_msgs/msg/Vector3"], "geometry_msgs/msg/Transform"
    poses = {
        "/device_0/sensor_0/Depth_0": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, -1.0)),
        "/device_0/sensor_1/Color_0": (
            (0.014999999664723873, 0.019999999552965164, -0.009999999776482582),
            (0.0, 0.0, -0.14943814277648926, -0.9887710809707642),
        ),
    }
    first = min(m[0] for m in messages)
    listed = []
    for log_ns, topic, type_name, value in messages:
        if topic not in (COLOUR, DEPTH, INFO):
            continue
        value = copy.deepcopy(value)
        value.header.frame_id = "0"
        if topic == INFO:
            listed += [[log_ns, f"{p}/info/camera_info", type_name, value] for p in poses]
        elif topic == DEPTH:
            codes = image(value, depth_codes(value), "mono16")
            listed.append([log_ns, STREAMS[DEPTH] + "data", "sensor_msgs/msg/Image", codes])
        else:
            listed.append([log_ns, STREAMS[COLOUR] + "data", type_name, value])
    for prefix, (xyz, xyzw) in poses.items():
        x, y, z, w = xyzw
        pose = TYPES[kind](
            translation=vector(x=xyz[0], y=xyz[1], z=xyz[2]),
            rotation=quaternion(x=x, y=y, z=z, w=w),
        )
        listed.append([first, f"{prefix}/tf/1", kind, pose])
    alignment = opened(write(tmp_path / "a.mcap", listed)).reader.camera.alignment
    assert alignment is not None
    there = alignment.T_colour_depth @ [0.1, 0.2, 1.0, 1.0]
    np.testing.assert_allclose(there[:3], [0.0514296, 0.2406193, 0.99], atol=1e-6)
