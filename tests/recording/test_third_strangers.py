"""Catches: what a third stranger's logs had and nobody was told, or told for an untrue reason."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.recording.contract import CLOSE_EVENT
from dgeval.recording.messages import event_of
from dgeval.recording.robot import states_period_s
from dgeval.recording.transforms import TransformTree
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    EVENTS,
    INFO,
    JOINTS,
    TYPES,
    Message,
    contents,
    names,
    opened,
    write,
)

STRING, BOOL = "std_msgs/msg/String", "std_msgs/msg/Bool"
S = 1_000_000_000


def without_frame(messages: list[Message], topics: tuple[str, ...]) -> list[Message]:
    out = []
    for log_ns, topic, kind, value in messages:
        if topic in topics:
            value = copy.deepcopy(value)
            value.header.frame_id = ""
        out.append([log_ns, topic, kind, value])
    return out


def test_images_without_a_frame_are_where_their_camera_info_is(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    trial = opened(write(tmp_path / "a.mcap", without_frame(messages, (COLOUR, DEPTH))))
    assert contents(trial) == original
    assert names(trial) == []


def test_where_nothing_names_the_cameras_frame_it_is_said(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a frame called 'camera', which nobody wrote, is said not to be in /tf."""
    trial = opened(write(tmp_path / "a.mcap", without_frame(messages, (COLOUR, DEPTH, INFO))))
    assert names(trial) == ["poses"]
    assert "frames.camera" in trial.checks[0].mend
    assert not any("'camera'" in note for note in trial.notes)


def test_a_close_that_is_marked_when_the_fingers_have_closed(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a hand that closed in time is judged for a mark that a person made late."""
    kept = [m for m in messages if m[1] != EVENTS]
    fingers_ns = opened(write(tmp_path / "a.mcap", kept)).close.fingers_ns
    assert fingers_ns is not None
    late = [fingers_ns + int(0.65 * S), EVENTS, STRING, TYPES[STRING](data="close")]
    trial = opened(write(tmp_path / "b.mcap", [*kept, late]))
    assert names(trial) == ["events"]
    assert "--close +" in trial.checks[0].mend
    given = trial.checks[0].mend.rsplit("+", 1)[1]
    assert float(given) == pytest.approx((fingers_ns - trial.pairs[0].t_ns) / S, abs=0.01)


def test_a_recorder_without_times(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where marks without stamps lie before the first picture, and nobody is told."""
    trial = opened(write(tmp_path / "a.mcap", [[0, *m[1:]] for m in messages]))
    (told,) = [c for c in trial.checks if c.name == "stamps"]
    assert "all 0 ns" in told.what
    assert not any("recorder's clock" in note for note in trial.notes)


def test_a_topic_that_may_say_how_it_ended(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a success is inferred beside /grasp_success = false, without a word of it."""
    kept = [m for m in messages if m[1] != EVENTS]
    end = max(m[0] for m in kept)
    said = [end, "/grasp_success", BOOL, TYPES[BOOL](data=False)]
    other = [end, "/light/on", BOOL, TYPES[BOOL](data=False)]
    trial = opened(write(tmp_path / "a.mcap", [*kept, said, other]))
    (note,) = [n for n in trial.notes if "how it ended" in n]
    assert "/grasp_success" in note
    assert "/light" not in note


def test_states_twice_a_second_are_no_late_pictures(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the bridged states are a delay of the pictures, with a setting that makes it
    worse.
    """
    joints = [m for m in messages if m[1] == JOINTS]
    few = {id(m) for k, m in enumerate(joints) if k % max(1, len(joints) // 10) == 0}
    listed = [m for m in messages if m[1] != JOINTS or id(m) in few]
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert names(trial) == ["poses"]
    assert "clock" not in trial.checks[0].mend


def test_a_mount_that_is_published_seldom_is_no_state() -> None:
    """Fails where pictures that are late are blamed on a transform that never changes."""
    tree = TransformTree(500_000_000)
    still, moved = np.array([0, 0, 0.1, 0, 0, 0, 1.0]), np.array([0, 0, 0.2, 0, 0, 0, 1.0])
    for k in range(5):
        tree.add_moving(k * S, "hand", "camera", still)
    for k in range(50):
        tree.add_moving(k * S // 50, "base", "hand", moved if k % 2 else still)
    robot: Any = SimpleNamespace(tree=tree, camera_frame="camera", description=None)
    assert states_period_s(robot) == pytest.approx(0.02)


def test_an_events_own_time_may_be_a_string() -> None:
    """JSON writes integers of 64 bits so."""
    text = json.dumps({"event": CLOSE_EVENT, "t_ns": "1780000003200000000"})
    assert event_of(text, 5).t_ns == 1780000003200000000
    with pytest.raises(ValueError, match="whole number"):
        event_of('{"event": "close", "t_ns": 1780000003.2}', 5)
