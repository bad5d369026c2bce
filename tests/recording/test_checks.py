"""Catches: a check that fails too late or for a good recording, and a mend with the wrong sign."""

from __future__ import annotations

import copy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config, RolesConfig
from dgeval.geometry import Intrinsics
from dgeval.recording.alignment import Alignment
from dgeval.recording.cameras import choose_camera, intrinsics_of
from dgeval.recording.check import Findings
from dgeval.recording.checks import failed_checks
from dgeval.recording.clock_checks import clock_check
from dgeval.recording.clocks import StampFaults, clean_stamps
from dgeval.recording.messages import CameraModel
from dgeval.recording.pairing import Pair, Window
from dgeval.recording.robot import JointTrack
from dgeval.recording.scan import ImageHead, TopicTimes
from tests.recording.recorders import COLOUR, DEPTH, JOINTS, Message, opened, write

S = 1_000_000_000


def delayed(messages: list[Message], topics: tuple[str, ...], by_s: float) -> list[Message]:
    """Header stamps of some topics earlier by a time, as of a clock that is behind."""
    out = []
    for m in messages:
        value = m[3]
        if m[1] in topics:
            value = copy.deepcopy(value)
            t = value.header.stamp.sec * S + value.header.stamp.nanosec - round(by_s * S)
            value.header.stamp.sec, value.header.stamp.nanosec = t // S, t % S
        out.append([*m[:3], value])
    return out


@pytest.mark.parametrize(("by_s", "word"), [(0.9, "behind"), (-0.9, "ahead of")])
def test_the_mend_of_a_clock_mends_it(
    tmp_path: Path, messages: list[Message], by_s: float, word: str
) -> None:
    """Fails where the side is named wrongly, or the offset has the wrong sign."""
    path = write(tmp_path / "a.mcap", delayed(messages, (COLOUR, DEPTH), by_s))
    trial = opened(path)
    clock, _ = clock_check(trial.scan, trial.roles, Config().clock)
    assert clock is not None
    assert f"{abs(by_s):.2f} s {word}" in clock.what
    settings = clock.mend.removeprefix("--set ").split(" --set ")
    assert "clocks" not in [c.name for c in opened(path, *settings).checks]


def test_the_robots_topic_that_is_farthest_off_counts(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a second topic with the right clock hides the wrong one."""
    other = [[m[0], "/extra/joint_states", m[2], m[3]] for m in messages if m[1] == JOINTS]
    listed = [*delayed(messages, (JOINTS,), 2.0), *other]
    trial = opened(write(tmp_path / "a.mcap", listed))
    clock, _ = clock_check(trial.scan, trial.roles, Config().clock)
    assert clock is not None
    assert JOINTS in clock.what


def checks_of(
    monkeypatch: pytest.MonkeyPatch, known: int, n: int = 40, dropped: int = 0
) -> list[str]:
    """Names of the failed checks of a trial with poses in `known` of n frames."""
    stamps = [k * 33_000_000 for k in range(n)]
    pairs = tuple(Pair(t, k, k) for k, t in enumerate(stamps))
    faults = {"colour": StampFaults(0, dropped, 0, 0)}
    scan: Any = SimpleNamespace(
        times={"/c": TopicTimes(stamps, stamps), "/d": TopicTimes(stamps, stamps)},
        opened=SimpleNamespace(topics={}),
        poses={},
        candidates=[],
        candidate_scores=[],
        recorder_clock=None,
        images={"/d": ImageHead("16UC1", 4, 4, "c", "")},
        events=[],
    )
    roles: Any = SimpleNamespace(colour="/c", depth="/d", joints=(), rival=None)
    robot: Any = SimpleNamespace(
        base_frame="base",
        palm_frame=None,
        conflict="",
        hands=(),
        changed=(),
        hand_links=(),
        joints=JointTrack(),
        samples=(),
        description=None,
        T_base_camera=lambda t: np.eye(4) if t < known * 33_000_000 else None,
    )
    window = Window(0, stamps[-1], pairs, 0, 0, faults)
    reader: Any = SimpleNamespace(robot=robot, camera=SimpleNamespace(doubt=""))
    monkeypatch.setattr("dgeval.recording.checks.frame_checks", lambda *_: Findings([]))
    found = failed_checks(scan, roles, robot, window, reader, Config().clock, None)
    return [c.name for c in found.failed]


def test_poses_in_fewer_than_half_of_the_frames_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    assert checks_of(monkeypatch, 19) == ["poses"]
    assert checks_of(monkeypatch, 20) == []


def test_stamps_that_cost_a_tenth_of_a_stream_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    assert checks_of(monkeypatch, 40, dropped=5) == ["stamps"]
    assert checks_of(monkeypatch, 40, dropped=4) == []


def head(frame: str, encoding: str = "rgb8", width: int = 64) -> ImageHead:
    return ImageHead(encoding, width, 48, frame, encoding)


def scan_with(heads: dict[str, ImageHead], cameras: dict[str, tuple[str, int]]) -> Any:
    models = {
        name: CameraModel(Intrinsics(w, 48, 60.0, 60.0, 31.5, 23.5), frame, (), None, (w, 48))
        for name, (frame, w) in cameras.items()
    }
    times = {name: TopicTimes(list(range(9)), list(range(9))) for name in heads}
    return SimpleNamespace(
        images=heads, cameras=models, times=times, descriptions={}, tf={}, joints={}
    )


def test_colour_that_can_be_aligned_goes_before_aligned_infrared() -> None:
    """Fails where depth that fits the infrared picture makes it the colour picture."""
    heads = {
        "/cam/infra1/image": head("ir", "mono8"),
        "/cam/color/image": head("rgb"),
        "/cam/depth/image": head("ir", "16UC1"),
    }
    infos = {"/cam/infra1/camera_info": ("ir", 64), "/cam/color/camera_info": ("rgb", 64),
             "/cam/depth/camera_info": ("ir", 64)}  # fmt: skip
    scan = scan_with(heads, infos)
    colour, depth, _ = choose_camera(scan, heads, RolesConfig())
    assert (colour, depth) == ("/cam/color/image", "/cam/depth/image")


def test_intrinsics_of_the_pictures_size_go_before_those_of_a_nearer_name() -> None:
    heads = {"/cam/color/image": head("rgb", width=64)}
    infos = {"/cam/color/camera_info": ("rgb", 128), "/cam/camera_info": ("rgb", 64)}
    assert intrinsics_of(scan_with(heads, infos), heads, "/cam/color/image") == "/cam/camera_info"


def test_intrinsics_of_another_picture_are_not_taken_for_their_name() -> None:
    """Fails where the depth camera's matrix, near by name, is used for colour."""
    heads = {"/cam/color/image": head("rgb"), "/cam/depth/image": head("ir", "16UC1")}
    scan = scan_with(heads, {"/cam/color/camera_info": ("ir", 64)})
    assert intrinsics_of(scan, heads, "/cam/color/image") is None
    scan = scan_with(heads, {"/cam/color/camera_info": ("link", 64)})
    assert intrinsics_of(scan, heads, "/cam/color/image") == "/cam/color/camera_info"


def test_what_is_nearer_hides_what_is_behind_it() -> None:
    """Fails where the far one of two readings on one colour pixel is kept."""
    narrow = Intrinsics(8, 8, 8.0, 8.0, 3.5, 3.5)
    coarse = Intrinsics(4, 4, 4.0, 4.0, 1.5, 1.5)
    T = np.eye(4)
    T[0, 3] = 0.1
    depth = np.full((8, 8), 1.0, np.float32)
    depth[:, 2] = 0.4
    out = Alignment(narrow, coarse, T).apply(depth)
    rows = out[2]
    assert (rows == np.float32(0.4)).any()
    flipped = Alignment(narrow, coarse, T).apply(depth[:, ::-1].copy())
    assert (flipped == np.float32(0.4)).any()


def test_a_zero_stamp_gets_the_offset_too() -> None:
    header = np.array([1000, 0, 3000])
    log = np.array([1100, 2100, 3100])
    used, _, faults = clean_stamps(header, log, 50, 10**9)
    assert used.tolist() == [1050, 2150, 3050]
    assert faults.zero == 1
