"""Catches: what people and robots mark, dropped or misread: labels, closes, clocks."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest
from dgeval.config import Config, load_config
from dgeval.errors import UsageError
from dgeval.recording.clocks import recorder_clock
from dgeval.recording.contract import CLOSE_EVENT, LABEL_EVENT
from dgeval.recording.found_config import found_config
from dgeval.recording.manifest import find_trials
from dgeval.recording.messages import event_of
from dgeval.recording.trials import open_trial
from hypothesis import given
from hypothesis import strategies as st
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    EVENTS,
    JOINTS,
    TYPES,
    Message,
    names,
    opened,
    write,
)

STRING = "std_msgs/msg/String"


def marked(messages: list[Message], drop: tuple[str, ...], *texts: str) -> list[Message]:
    """The demo without events of some kinds, and with further ones at its end."""
    kept = [m for m in messages if m[1] != EVENTS or event_of(m[3].data, m[0]).kind not in drop]
    last = max(m[0] for m in messages)
    said = [[last, EVENTS, STRING, TYPES[STRING](data=text)] for text in texts]
    return kept + said


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ('{"event": "label", "label": true}', "success"),
        ('{"event": "label", "label": false}', "failure"),
        ('{"event": "label", "outcome": "FAILED "}', "failure"),
        ('{"success": false}', "failure"),
        ('{"event": "success"}', "success"),
        ("failure", "failure"),
    ],
)
def test_a_label_in_other_words(
    tmp_path: Path, messages: list[Message], text: str, label: str
) -> None:
    trial = opened(write(tmp_path / "a.mcap", marked(messages, (LABEL_EVENT,), text)))
    assert trial.events.label() == label
    assert not trial.checks


@pytest.mark.parametrize(
    ("texts", "what"),
    [
        (('{"event": "label", "label": "dropped"}',), "'dropped'"),
        (('{"event": "label", "label": 7}',), "7"),
        (("success", "failure"), "contradict"),
    ],
)
def test_a_label_that_can_not_be_used_fails_a_check(
    tmp_path: Path, messages: list[Message], texts: tuple[str, ...], what: str
) -> None:
    """Fails where an operator's word is dropped without a word."""
    trial = opened(write(tmp_path / "a.mcap", marked(messages, (LABEL_EVENT,), *texts)))
    (check,) = trial.checks
    assert check.name == "label"
    assert what in check.what


def test_prose_is_quoted(tmp_path: Path, messages: list[Message]) -> None:
    trial = opened(write(tmp_path / "a.mcap", marked(messages, (), "gripper slipped a bit")))
    assert not trial.damage, "an unknown word is no damage to the file"
    assert any("gripper slipped a bit" in c.what for c in trial.checks if c.name == "events")


def test_a_close_outside_of_the_images_fails_a_check(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a t_ns that is hours off makes the close vanish."""
    text = json.dumps({"event": "close", "t_ns": 1780009003000000000})
    trial = opened(write(tmp_path / "a.mcap", marked(messages, (CLOSE_EVENT,), text)))
    assert "events" in [c.name for c in trial.checks]


def test_fingers_that_are_seen_closing_go_before_a_trial_end(
    tmp_path: Path, messages: list[Message], demo: Path
) -> None:
    """Fails where a success becomes "the hand never closed" for want of a close event."""
    plain = opened(demo)
    trial = opened(
        write(tmp_path / "a.mcap", marked(messages, (CLOSE_EVENT,), '{"event": "trial_end"}'))
    )
    assert trial.close.source == "joints"
    close_ns, recorded_ns = trial.event_ns(CLOSE_EVENT), plain.event_ns(CLOSE_EVENT)
    assert close_ns is not None
    assert recorded_ns is not None
    assert abs(close_ns - recorded_ns) < 100_000_000


def test_without_finger_joints_a_trial_end_is_no_proof(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where an absent topic is read as fingers that did not move."""
    listed = marked(messages, (CLOSE_EVENT, "lift"), '{"event": "trial_end"}')
    changed = []
    for m in listed:
        value = m[3]
        if m[1] == JOINTS:
            value = copy.deepcopy(value)
            arm = [k for k, n in enumerate(value.name) if "finger" not in n and "thumb" not in n]
            arm = arm[:7]
            value.name = [value.name[k] for k in arm]
            value.position = value.position[arm]
            value.velocity, value.effort = value.velocity[:0], value.effort[:0]
        changed.append([*m[:3], value])
    trial = opened(write(tmp_path / "a.mcap", changed))
    assert trial.close.missing is not None
    assert "--close" in trial.close.missing


def shifted(messages: list[Message], topics: tuple[str, ...], after_s: float, by_s: float) -> list:
    """Header stamps of some topics moved from a time on."""
    first = min(m[0] for m in messages)
    out = []
    for m in messages:
        value = m[3]
        if m[1] in topics and m[0] - first > after_s * 1e9:
            value = copy.deepcopy(value)
            t = value.header.stamp.sec * 10**9 + value.header.stamp.nanosec + round(by_s * 1e9)
            value.header.stamp.sec, value.header.stamp.nanosec = t // 10**9, t % 10**9
        out.append([*m[:3], value])
    return out


def test_a_clock_that_is_set_forward_fails_a_check(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where half the trial is cut off by its end, and nobody is told."""
    changed = shifted(messages, (COLOUR, DEPTH, JOINTS), 2.0, 2.0)
    found = names(opened(write(tmp_path / "a.mcap", changed)))
    assert {"stamps", "gap"} <= set(found)


def test_a_hole_in_the_images_fails_a_check(tmp_path: Path, messages: list[Message]) -> None:
    first = min(m[0] for m in messages)
    kept = [m for m in messages if m[1] not in (COLOUR, DEPTH) or not 1.0e9 < m[0] - first < 2.4e9]
    assert names(opened(write(tmp_path / "a.mcap", kept))) == ["gap"]


@pytest.mark.parametrize("speed", [1.0, 2.5])
def test_a_simulators_clock(tmp_path: Path, messages: list[Message], speed: float) -> None:
    """Fails where events that were logged by the wall's clock are looked for among stamps that
    begin at zero, or a simulation that runs slower than real shifts them.
    """
    first = min(m[0] for m in messages)
    changed = []
    for m in messages:
        value = copy.deepcopy(m[3])
        if m[1] == EVENTS:
            said = json.loads(value.data)
            said.pop("t_ns", None)
            value.data = json.dumps(said)
        elif hasattr(value, "header"):
            t = value.header.stamp.sec * 10**9 + value.header.stamp.nanosec - first + 10**10
            value.header.stamp.sec, value.header.stamp.nanosec = t // 10**9, t % 10**9
        changed.append([first + round((m[0] - first) * speed), *m[1:3], value])
    trial = opened(write(tmp_path / "a.mcap", changed))
    plain = opened(write(tmp_path / "b.mcap", messages))
    assert len(trial.pairs) == len(plain.pairs)
    assert not trial.checks
    close_ns, recorded_ns = trial.event_ns(CLOSE_EVENT), plain.event_ns(CLOSE_EVENT)
    assert close_ns is not None
    assert recorded_ns is not None
    assert abs((close_ns - trial.pairs[0].t_ns) - (recorded_ns - plain.pairs[0].t_ns)) < 30_000_000
    assert any("recorder's clock" in note for note in trial.notes)


@given(st.integers(0, 10**10), st.floats(0.2, 5.0))
def test_the_recorders_clock_is_followed_between_and_beyond_its_messages(
    at: int, speed: float
) -> None:
    import numpy as np

    header = np.arange(1, 80, dtype=np.int64) * 33_000_000
    log = 1_700_000_000_000_000_000 + (header * speed).astype(np.int64)
    clock = recorder_clock({"/camera": (header, log)})
    assert clock is not None
    inside = int(log[0]) + at % int(log[-1] - log[0])
    assert abs(clock.stamp_ns(inside) - (inside - 1_700_000_000_000_000_000) / speed) < 10
    assert clock.stamp_ns(int(log[-1]) + at) == int(header[-1]) + at
    assert recorder_clock({"/camera": (header, header + 50_000_000)}) is None


def test_the_configuration_that_was_found_changes_nothing(tmp_path: Path, demo: Path) -> None:
    """Fails where a file made by `inspect --config` can't be read, or leads to other roles."""
    text = found_config(demo, Config())
    file = tmp_path / "robot.toml"
    file.write_text(text, encoding="utf-8")
    (spec,) = find_trials([demo])
    a, b = open_trial(spec, Config()), open_trial(spec, load_config(str(file), ()))
    assert a.roles == b.roles
    assert (a.robot.base_frame, a.robot.palm_frame) == (b.robot.base_frame, b.robot.palm_frame)
    assert a.notes == b.notes


def test_what_is_said_of_a_hand_that_is_known_is_told_to_count_for_nothing(demo: Path) -> None:
    """Fails where a setting is left out without a word."""
    config = load_config("dynamic", ("hand.centre=[0,0,0.1]", "hand.close_s=0.4"))
    (spec,) = find_trials([demo.parent / "ci-smoke" / "mug-040-0003.mcap"])
    told = [note for note in open_trial(spec, config).robot.notes if "whose own count" in note]
    assert len(told) == 1
    assert told[0].startswith("hand.centre, hand.close_s: ")
    with pytest.raises(UsageError, match="no direction"):
        load_config("dynamic", ("hand.approach=[0,0,0]",))
