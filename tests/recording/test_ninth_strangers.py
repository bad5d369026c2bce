"""Catches: what a ninth stranger's logs had that crashed, was lost, or was told untruly."""

from __future__ import annotations

import copy
import itertools
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from dgeval.config import Config
from dgeval.recording.containers.opening import open_container
from dgeval.recording.encodings import json_text
from dgeval.recording.manifest import find_trials
from dgeval.recording.messages import event_of, event_text
from dgeval.recording.splits import split_recordings
from dgeval.recording.trials import open_trial
from dgeval.verdict.log import log_of
from google.protobuf import struct_pb2
from rosbags.typesys import get_types_from_msg
from tests.recording.recorders import EVENTS, STORE, TYPES, Message, contents, names, opened, write

GRASP_EVENT = "grasp_msgs/msg/GraspEvent"
STORE.register(
    get_types_from_msg("std_msgs/Header header\nstring event\nstring label", GRASP_EVENT)
)
LOG = "rcl_interfaces/msg/Log"


def as_structure(text: str) -> tuple[str, Any]:
    said = json.loads(text)
    header = TYPES["std_msgs/msg/Header"](
        stamp=TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=""
    )
    label = said.get("label", "")
    return GRASP_EVENT, TYPES[GRASP_EVENT](header=header, event=said["event"], label=label)


def as_log_line(text: str) -> tuple[str, Any]:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    return LOG, TYPES[LOG](
        stamp=stamp, level=20, name="grasp", msg=text, file="", function="", line=0
    )


@pytest.mark.parametrize("as_other", [as_structure, as_log_line])
def test_events_of_another_type_are_the_same_events(
    tmp_path: Path, messages: list[Message], as_other: Any
) -> None:
    """Fails where an event that is no std_msgs/String ends in an internal error."""
    kept = [m for m in messages if m[1] != EVENTS]
    kept += [[m[0], EVENTS, *as_other(m[3].data)] for m in messages if m[1] == EVENTS]
    before, after = (
        opened(write(tmp_path / f"{name}.mcap", listed))
        for name, listed in (("a", messages), ("b", kept))
    )
    kinds = [(e.kind, e.t_ns, e.fields.get("label")) for e in before.scan.events]
    assert kinds
    assert [(e.kind, e.t_ns, e.fields.get("label") or None) for e in after.scan.events] == kinds
    assert after.spec.start_ns == before.spec.start_ns


def protobuf_struct() -> Any:
    made = struct_pb2.Value()
    made.string_value = "close"
    return made


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (json_text.decode(b'{"event": "close", "t_ns": 5}'), '{"event": "close", "t_ns": 5}'),
        (json_text.decode(b'{"data": "close"}'), "close"),
        (json_text.decode(b'{"success": true}'), '{"success": true}'),
        (json_text.decode(b'{"event": "end", "of": {"n": 1}}'), '{"event": "end", "of": {"n": 1}}'),
        (SimpleNamespace(message="lift", level=2), "lift"),
    ],
)
def test_the_text_of_an_event(message: Any, text: str) -> None:
    assert event_text(message) == text
    assert event_of(event_text(message), 5).t_ns == 5


@pytest.mark.parametrize("message", [SimpleNamespace(), SimpleNamespace(data=3), protobuf_struct()])
def test_what_has_no_text_is_no_event(message: Any) -> None:
    with pytest.raises(ValueError, match="no text"):
        event_text(message)


def test_events_that_have_no_text_are_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a topic of another type is passed over without a word."""
    number = TYPES["std_msgs/msg/Int32"]
    other = [
        [m[0], EVENTS, "std_msgs/msg/Int32", number(data=1)] if m[1] == EVENTS else m
        for m in messages
    ]
    trial = opened(write(tmp_path / "a.mcap", other))
    assert any("an event's message has no text, but data" in str(d) for d in trial.damage)


def parts(folder: Path, messages: list[Message], cuts: int = 4) -> list[Path]:
    """The messages as a split recording of so many parts."""
    folder.mkdir()
    listed = sorted(messages, key=lambda m: m[0])
    edges = [round(k * len(listed) / cuts) for k in range(cuts + 1)]
    return [
        write(folder / f"{folder.name}_{k}.mcap", copy.copy(listed[a:b]))
        for k, (a, b) in enumerate(itertools.pairwise(edges))
    ]


@pytest.mark.parametrize("left", [b"", b"\x00" * 64])
@pytest.mark.parametrize("cuts", [2, 4])
def test_a_last_part_of_which_nothing_is_left(
    tmp_path: Path, messages: list[Message], left: bytes, cuts: int
) -> None:
    """Fails where a recorder that was killed makes a trial of each part of one."""
    files = parts(tmp_path / "run", messages, cuts)
    whole = contents(opened(write(tmp_path / "whole.mcap", sorted(messages, key=lambda m: m[0]))))
    files[-1].write_bytes(left)
    (spec,) = find_trials([tmp_path / "run"])
    assert spec.parts == tuple(files)
    damage = open_container(spec.recording, spec.parts).damage
    assert [f"{files[-1].name} can't be read" in str(d) for d in damage] == [True]
    found = contents(open_trial(spec, Config()))
    assert found
    assert found == whole[: len(found)]


def test_an_empty_file_behind_one_trial_is_no_part_of_it(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a numbered trial whose recorder did not start damages the one before."""
    files = [write(tmp_path / "trial_0.mcap", messages), tmp_path / "trial_1.mcap"]
    files[1].write_bytes(b"")
    assert split_recordings(files) == [(f,) for f in files]
    between = [*parts(tmp_path / "run", messages, 3)]
    between[1].write_bytes(b"")
    assert split_recordings(between) == [(f,) for f in between]


def test_events_whose_times_are_no_times_of_the_trial_place_no_close(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a converter that wrote every log time as 0 makes a search of 56 years."""
    unplaced = copy.deepcopy(messages)
    for m in unplaced:
        m[0] = 0
        if m[1] == EVENTS:
            said = json.loads(m[3].data)
            m[3].data = said.get("label") or said["event"]
    trial = opened(write(tmp_path / "a.mcap", unplaced))
    assert {"events", "stamps"} <= set(names(trial))
    assert trial.close.source == "joints"
    log = log_of(trial)
    assert log.close_ns is not None
    assert log.first_ns < log.close_ns < log.last_ns
    assert log.label == "success"
