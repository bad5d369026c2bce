"""Catches: what an eighth stranger's logs had and nobody was told, or told for an untrue reason."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.recording.transforms import TransformTree
from tests.recording.recorders import JOINTS, Message, contents, opened, write


def with_states(messages: list[Message], change: Any) -> list[Message]:
    """The messages with each joint state changed."""
    made = []
    for m in messages:
        if m[1] == JOINTS:
            m = [*m[:3], copy.deepcopy(m[3])]
            change(m[3])
        made.append(m)
    return made


def test_efforts_of_another_number_than_the_joints_are_nobodys(
    tmp_path: Path, messages: list[Message]
) -> None:
    def cut(state: Any) -> None:
        state.effort = np.full(len(state.name) - 2, 0.5)

    def without(state: Any) -> None:
        state.effort = np.zeros(0)

    trial = opened(write(tmp_path / "a.mcap", with_states(messages, cut)))
    other = opened(write(tmp_path / "b.mcap", with_states(messages, without)))
    assert not any(s.efforts for s in trial.robot.samples)
    assert any(f"efforts of {JOINTS} are left out" in n for n in trial.notes)
    assert not any("efforts" in n and "left out" in n for n in other.notes)
    assert contents(trial) == contents(other)


def test_positions_of_another_number_than_the_joints_are_damage(
    tmp_path: Path, messages: list[Message]
) -> None:
    def longer(state: Any) -> None:
        state.position = np.append(state.position, 0.0)

    trial = opened(write(tmp_path / "a.mcap", with_states(messages, longer)))
    assert any("positions for" in str(d) and JOINTS in str(d) for d in trial.damage)


def test_what_a_tree_keeps_of_one_time_is_not_of_the_next() -> None:
    tree = TransformTree()
    for t in range(3):
        for child, x in (("a", t), ("b", 2 * t)):
            pose = np.array([x, 0, 0, 0, 0, 0, 1.0])
            tree.add_moving(t * 100_000_000, "world", child, pose)
    for t in range(3):
        for _ in range(2):
            T = tree.lookup("a", "b", t * 100_000_000)
            assert T is not None
            assert T[0, 3] == t
