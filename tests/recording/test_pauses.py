"""Catches: two trials of a paused recorder taken for one, one trial cut in two at lost images."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
from dgeval.config import Config
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from tests.recording.recorders import Message, write


def twice(messages: list[Message], pause_s: float, but: str | None = None) -> list[Message]:
    """The demo without its events, and once more after a pause; a topic that goes on meanwhile."""
    listed = [m for m in messages if not m[1].startswith("/dgeval")]
    span = max(m[0] for m in listed) - min(m[0] for m in listed) + round(pause_s * 1e9)
    out = list(listed)
    for m in listed:
        if m[1] in ("/tf_static", "/robot_description"):
            continue  # latched: the recorder heard them once
        again = copy.deepcopy(m)
        again[0] += span
        stamp = getattr(getattr(again[3], "header", None), "stamp", None)
        if stamp is not None:
            t_ns = stamp.sec * 10**9 + stamp.nanosec + span
            stamp.sec, stamp.nanosec = t_ns // 10**9, t_ns % 10**9
        out.append(again)
    if but is not None:
        one = next(m for m in listed if m[1] == but)
        out += [[one[0] + k * 10**9, *one[1:]] for k in range(1, span // 10**9)]
    return out


def test_a_recorder_that_was_paused_between_two_trials(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where two trials are one with a gap, or what was latched is in the first alone."""
    path = write(tmp_path / "a.mcap", twice(messages, 8.0))
    first, second = find_trials([path])
    assert [first.id, second.id] == ["a#0", "a#1"]
    alone = [m for m in messages if not m[1].startswith("/dgeval")]
    (whole,) = find_trials([write(tmp_path / "b.mcap", alone)])
    expected = open_trial(whole, Config())
    for spec in (first, second):
        trial = open_trial(spec, Config())
        assert len(trial.pairs) == len(expected.pairs)
        assert trial.robot.description is not None
        assert not trial.checks
        assert any("pauses" in note for note in trial.notes)


def test_without_a_robot_lost_images_are_no_pause(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where nothing but images is recorded, and a hole in them begins another trial."""
    listed = [m for m in twice(messages, 8.0) if m[1] not in ("/joint_states", "/tf")]
    (spec,) = find_trials([write(tmp_path / "a.mcap", listed)])
    assert "gap" in [c.name for c in open_trial(spec, Config()).checks]


@pytest.mark.parametrize(("pause_s", "but"), [(2.0, None), (8.0, "/joint_states")])
def test_what_is_no_pause_is_no_end_of_a_trial(
    tmp_path: Path, messages: list[Message], pause_s: float, but: str | None
) -> None:
    """Fails where a trial is cut in two at images that were lost while the robot went on."""
    path = write(tmp_path / "a.mcap", twice(messages, pause_s, but))
    (spec,) = find_trials([path])
    assert "gap" in [c.name for c in open_trial(spec, Config()).checks]
