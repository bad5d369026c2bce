"""Catches: a hand that has another verdict, or none, because nobody told dgeval its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dgeval import api
from dgeval.perception.pipeline import Perception
from dgeval.robots.described_hand import DescribedHand
from dgeval.verdict.judge import Judgement
from dgeval.verdict.log import log_of
from dgeval.verdict.outcome import outcome_of
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
JOINT_STATE, STRING = "sensor_msgs/msg/JointState", "std_msgs/msg/String"
COLLIDED = Path(__file__).parents[2] / "datasets" / "ci-smoke" / "pudding_box-120-0030.mcap"
OTHER_NAMES = {"thumb": "f5", "index": "f1", "middle": "f2", "ring": "f3", "little": "f4"}


def renamed(text: str) -> str:
    for name, other in OTHER_NAMES.items():
        text = text.replace(name, other)
    return text


def rewritten(source: Path, target: Path, effort: float, names: bool) -> Path:
    """The recording with so much added to each effort, Nm; names: with other names of fingers."""
    with source.open("rb") as read, target.open("wb") as written:
        writer = Writer(written)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(read).iter_messages():
            assert schema is not None
            if channel.topic not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", kind)
            data = message.data
            if schema.name == JOINT_STATE:
                states = STORE.deserialize_cdr(data, JOINT_STATE)
                states.name = [renamed(n) if names else n for n in states.name]
                states.effort = np.asarray(states.effort) + effort
                data = bytes(STORE.serialize_cdr(states, JOINT_STATE))
            elif names and channel.topic == "/robot_description":
                text = STORE.deserialize_cdr(data, STRING)
                text.data = renamed(text.data)
                data = bytes(STORE.serialize_cdr(text, STRING))
            writer.add_message(channels[channel.topic], message.log_time, data, message.log_time)
        writer.finish()
    return target


def judged(path: Path) -> Judgement:
    trial = api.open_trial(path)
    assert isinstance(trial.robot.hand, DescribedHand)
    perception = Perception(trial.config)
    hindsight = api.look_back(trial, api.replay_trial(trial, perception), perception)
    return api.judge_trial(trial, hindsight)


@pytest.mark.slow
def test_a_hand_under_other_names_has_the_same_verdict(tmp_path: Path) -> None:
    """By name: a collision of the middle finger's last link with 0.91; nobody labelled it."""
    found = judged(rewritten(COLLIDED, tmp_path / "a.mcap", 0.0, names=True))
    assert (found.row.outcome, found.row.failure_class) == ("failure", "collision")
    # by its description alone it is never as sure as its draws
    assert 0.8 < (found.row.p_collision or 0.0) < 0.85
    assert found.link == "f2_3"
    assert any("5 fingers on 'hand_base', by the description alone" in n for n in found.notes)


@pytest.mark.parametrize(("effort", "outcome"), [(0.0, "failure"), (0.15, "unknown")])
def test_efforts_whose_zero_is_off_are_no_success(
    tmp_path: Path, effort: float, outcome: str
) -> None:
    """Fails where every finger of an empty hand still presses, by 0.15 Nm."""
    trial = api.open_trial(rewritten(COLLIDED, tmp_path / "a.mcap", effort, names=False))
    found = outcome_of(log_of(trial), None)
    assert found.outcome == outcome
    assert ("is their zero off" in found.evidence) == (outcome == "unknown")


def test_fingers_that_hang_from_the_close_on_say_nothing(tmp_path: Path) -> None:
    """Fails where a driver that hangs makes a failure of a success."""
    trial = api.open_trial(rewritten(COLLIDED, tmp_path / "a.mcap", 0.0, names=False))
    log = log_of(trial)
    assert log.close_ns is not None
    held = next(s for s in reversed(log.hand_samples) if s.t_ns <= log.close_ns)
    until = log.close_ns
    samples = tuple(s if s.t_ns <= until else replace(held, t_ns=s.t_ns) for s in log.hand_samples)
    found = outcome_of(replace(log, hand_samples=samples), None)
    assert found.outcome == "unknown"
    assert "does their driver hang" in found.evidence
