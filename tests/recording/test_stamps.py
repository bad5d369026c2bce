"""Catches: stamps that are wrong in a way that their sentence does not say."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from dgeval.config import Config
from dgeval.errors import UnreadableError
from dgeval.recording.inspection import inspect_recording
from dgeval.recording.manifest import find_trials
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    EVENTS,
    INFO,
    JOINTS,
    Message,
    names,
    opened,
    write,
)

S = 1_000_000_000
STAMPED = (COLOUR, DEPTH, INFO, JOINTS)


def restamped(message: Message, change: Callable[[int], int]) -> Message:
    value: Any = copy.deepcopy(message[3])
    stamp = value.header.stamp
    stamp.sec, stamp.nanosec = divmod(change(stamp.sec * S + stamp.nanosec), S)
    return [*message[:3], value]


def with_stamps(
    messages: list[Message], topics: tuple[str, ...], change: Callable[[int], int]
) -> list[Message]:
    return [restamped(m, change) if m[1] in topics else m for m in messages]


@pytest.mark.parametrize("change", [lambda t: t // S * S, lambda t: t // S * S + t % S // 1000])
@pytest.mark.parametrize("topics", [STAMPED, (JOINTS,)])
def test_stamps_without_fractions_are_told_as_that(
    tmp_path: Path,
    messages: list[Message],
    topics: tuple[str, ...],
    change: Callable[[int], int],
) -> None:
    """Fails where whole seconds are called a clock that was set, or pictures out of order."""
    trial = opened(write(tmp_path / "a.mcap", with_stamps(messages, topics, change)))
    (told,) = [c for c in trial.checks if c.name == "stamps"]
    assert "no fractions of a second" in told.what
    assert JOINTS in told.what
    assert (COLOUR in told.what) == (COLOUR in topics)


def test_what_two_recorders_wrote_is_one_trial_and_is_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where every event twice makes two trials, or equal stamps are called out of order."""
    twice = [*messages, *([m[0] + 3_000_000, *m[1:]] for m in messages)]
    path = write(tmp_path / "a.mcap", twice)
    assert len(find_trials([path])) == 1
    trial = opened(path)
    once = opened(write(tmp_path / "b.mcap", messages))
    assert [e.kind for e in trial.events] == [e.kind for e in once.events]
    assert names(trial) == []  # nothing is lost
    assert "stamps: 69 duplicate in colour, 69 duplicate in depth" in trial.notes
    assert [p.t_ns for p in trial.pairs] == [p.t_ns for p in once.pairs]


def test_a_simulation_that_starts_again_is_named(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the answer to a clock that was set back is to look at `dgeval inspect`."""
    first = min(m[0] for m in messages)

    def again(t: int) -> int:
        since = t - first
        return since + 20 * S if since < 1.5 * S else since - 3 * S // 2 + S // 100

    own = [m for m in messages if m[1] in (*STAMPED, EVENTS, "/robot_description")]
    path = write(tmp_path / "a.mcap", with_stamps(own, STAMPED, again))
    with pytest.raises(UnreadableError, match="clock was set back") as raised:
        opened(path)
    assert "a file of its own" in str(raised.value)


def test_topics_without_stamps_have_no_clock(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where stamps that are all zero are a simulated clock that drifts by 1000000 ppm."""
    path = write(tmp_path / "a.mcap", with_stamps(messages, STAMPED, lambda _: 0))
    topics = {t["name"]: t for t in inspect_recording(path, Config())["topics"]}
    for name in STAMPED:
        assert topics[name]["unstamped"]
        assert "drift_ppm" not in topics[name]
    assert "unstamped" not in topics[EVENTS]


def test_one_picture_a_second_may_be_stamped_in_whole_seconds(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a slow camera's right stamps are called cut."""
    first = min(m[0] for m in messages)

    def slowly(t: int) -> int:
        return first // S * S + round((t - first) / 66_666_667) * S

    images = [m for m in messages if m[1] in (COLOUR, DEPTH, INFO)]
    slow = [[slowly(m[0]), *restamped(m, slowly)[1:]] for m in images]
    trial = opened(write(tmp_path / "a.mcap", slow))
    assert not [c for c in trial.checks if c.name == "stamps"]
