"""Catches: a window cut at the wrong image, another trial's events, a recording hashed twice."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.errors import Damage, Place, UnreadableError, UsageError
from dgeval.recording import trials
from dgeval.recording.checks import pair_check
from dgeval.recording.choices import accepted_flags, choice_span, recorded_choices
from dgeval.recording.contract import CLOSE_EVENT, TRIAL_START_EVENT
from dgeval.recording.events import AFTER_NS, Events, events_within
from dgeval.recording.frame_reader import LostFrames
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.messages import Event, StampedPose
from dgeval.recording.pairing import Pairing, Window, pair_images, window_of
from dgeval.recording.scan import TopicTimes
from dgeval.runs import workers
from dgeval.runs.folder import TrialResult

CONFIG = load_config()
FILE = Path("a.mcap")


def pairing(colour_ns: list[int], depth_ns: list[int], *settings: str) -> Pairing:
    """Images of two topics, logged when they are stamped."""
    times = {"/c": TopicTimes(colour_ns, colour_ns), "/d": TopicTimes(depth_ns, depth_ns)}
    config = load_config("dynamic", settings) if settings else CONFIG
    return pair_images(SimpleNamespace(times=times), "/c", "/d", config)  # type: ignore[arg-type]


def test_pairs_name_images_by_their_place_in_the_topic() -> None:
    """Fails where an image with a bad stamp shifts the ordinals of those after it."""
    made = pairing([100, 200, 150, 300], [101, 201, 301], "sync.tolerance_s=1e-8")
    assert made.pairs == ((100, 0, 0), (200, 1, 1), (300, 3, 2))
    assert made.indices == ((0, 0), (1, 1), (2, 2))
    assert (made.faults["colour"].backward, made.faults["depth"].backward) == (1, 0)


def test_each_role_gets_its_own_clock_offset() -> None:
    """Fails where the offsets of colour and depth are exchanged, or one is applied to both."""
    options = ("clock.colour.offset_ns=5", "clock.depth.offset_ns=-7")
    made = pairing([100, 200], [112, 212], *options, "sync.tolerance_s=1e-9")
    assert made.colour_ns.tolist() == made.depth_ns.tolist() == [105, 205]
    assert [p.t_ns for p in made.pairs] == [105, 205]


REGULAR = pairing([0, 100, 200, 300, 400], [0, 100, 200, 400], "sync.tolerance_s=1e-8")


def test_a_window_by_time_includes_both_ends_and_counts_what_has_no_partner() -> None:
    """Fails where an end is left out, or images outside the window count as unmatched."""
    window = window_of(REGULAR, TrialSpec("a", FILE, start_ns=100, end_ns=300), [])
    assert [p.t_ns for p in window.pairs] == [100, 200]
    assert (window.start_ns, window.end_ns) == (100, 300)
    assert (window.n_unmatched_colour, window.n_unmatched_depth) == (1, 0)


@pytest.mark.parametrize(
    ("depth_ns", "told"),
    [
        (range(0, 4000, 400), ""),  # a quarter of colour's rate loses nothing
        (range(0, 4000, 100), ""),
        ([*range(0, 400, 100), *range(450, 4000, 400)], "9 of 13 depth images"),
        (range(50, 4000, 100), "40 of 40 colour images"),
    ],
)
def test_pictures_without_a_partner_are_lost_by_the_rarer_stream(
    depth_ns: range, told: str
) -> None:
    """Fails where depth of a lower rate is a loss, and where `inspect` foretells less."""
    made = pairing(list(range(0, 4000, 100)), list(depth_ns), "sync.tolerance_s=1e-8")
    lone = (len(made.colour_ns) - len(made.pairs), len(made.depth_ns) - len(made.pairs))
    found = pair_check(Window(0, 4000, made.pairs, *lone, made.faults), CONFIG.sync)
    assert [told in check.what for check in found] == ([True] if told else [])


def test_a_window_by_frames_counts_pairs_and_takes_its_times_from_them() -> None:
    """Fails where frames are counted by colour images, or the last one is included."""
    window = window_of(REGULAR, TrialSpec("a", FILE, frames=(2, 4)), [])
    assert [p.t_ns for p in window.pairs] == [200, 400]
    assert (window.start_ns, window.end_ns, window.n_unmatched_colour) == (200, 400, 1)


def test_without_times_the_window_is_the_whole_recording() -> None:
    """Fails where an image at either end of the recording is dropped."""
    window = window_of(REGULAR, TrialSpec("a", FILE), [])
    assert (window.start_ns, window.end_ns, len(window.pairs)) == (0, 400, 4)


@pytest.mark.parametrize("frames", [(0, 5), (2, 2), (-1, 3)])
def test_frames_that_are_not_there_are_a_mistake_of_the_user(frames: tuple[int, int]) -> None:
    """Fails where Python's slices accept what the recording does not have."""
    with pytest.raises(UsageError, match="not within the recording's 4 paired frames"):
        window_of(REGULAR, TrialSpec("a", FILE, frames=frames), [])


def test_an_empty_window_names_the_damage() -> None:
    """Fails where a broken file reads like a wrong interval."""
    spec = TrialSpec("a", FILE, start_ns=1000, end_ns=2000)
    with pytest.raises(UnreadableError, match=r"between 1000 and 2000 ns \(damage: torn\)"):
        window_of(REGULAR, spec, [Damage("torn", Place("a.mcap"))])
    empty = pairing([], [])
    with pytest.raises(UnreadableError, match="between 0 and 0 ns"):
        window_of(empty, TrialSpec("a", FILE), [])


def test_events_end_a_second_after_the_window_but_not_after_the_trial() -> None:
    """Fails where the next trial's events are taken, or the end after the last image is lost."""
    every = [Event(t, CLOSE_EVENT, {}) for t in (9, 10, 20, 20 + AFTER_NS, 21 + AFTER_NS)]
    inside = [e.t_ns for e in events_within(every, 10, 20, None)]
    assert inside == [10, 20, 20 + AFTER_NS]
    assert [e.t_ns for e in events_within(every, 10, 20, 25)] == [10, 20]
    assert Events(tuple(every)).first_ns(CLOSE_EVENT) == 9
    assert Events().first_ns(CLOSE_EVENT) is None


def test_notes_come_from_the_start_of_a_trial_only() -> None:
    """Fails where any event's notes, or a text in place of a list, get into the trial's row."""
    entries = (
        Event(1, TRIAL_START_EVENT, {"notes": ["a", 2]}),
        Event(2, CLOSE_EVENT, {"notes": ["b"]}),
        Event(3, TRIAL_START_EVENT, {"notes": "c"}),
    )
    assert Events(entries).notes() == ["a", "2"]


def test_only_the_first_lost_frame_is_listed_and_all_are_counted() -> None:
    """Fails where a recording with a thousand broken images gets a thousand messages."""
    damage: list[Damage] = []
    lost = LostFrames(damage)
    for t_ns in (5, 6, 7):
        lost.add("broken", Place("a.mcap", t_ns=t_ns))
    assert lost.count == 3
    assert [d.place.t_ns for d in damage if d.place is not None] == [5]


def test_a_grasp_has_the_newest_score_by_then() -> None:
    """Fails where a later frame's score is taken, or one logged just after its grasp is missed."""
    pose = np.array([0, 0, 0, 0, 0, 0, 1.0])
    at = [3_000_000_000, 1_000_000_000, 500]
    scan: Any = SimpleNamespace(
        poses={"/dgeval/belief/grasp": [StampedPose(t, "base", "", pose) for t in at]},
        candidates=[],
        candidate_scores=[],
        numbers={"/dgeval/belief/score": [(1_000_900_000, 0.2), (1_002_000_000, 0.9)]},
        times={},
        recorder_clock=None,
    )
    robot: Any = SimpleNamespace(base_frame="base")
    choices = recorded_choices(scan, (0, 9_000_000_000), robot)
    assert choices.times == tuple(sorted(at))
    assert [choices.hand_scores.at(t) for t in sorted(at)] == [None, 0.2, 0.9]
    assert [choices.scores.at(t) for t in sorted(at)] == [None] * 3
    assert choices.grasp_at(499) is None


def test_a_known_hash_is_not_computed_again(demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where a recording of gigabytes is read once more for a hash that the caller has."""
    calls: list[Path] = []
    monkeypatch.setattr(trials, "sha256_of", lambda path, _: calls.append(path) or "computed")
    assert trials.open_trial(TrialSpec("a", demo), CONFIG, "given").sha256 == "given"
    assert calls == []
    assert trials.open_trial(TrialSpec("a", demo), CONFIG).sha256 == "computed"
    assert calls == [demo]
    with pytest.raises(UnreadableError, match="sha256 is given, the manifest says other"):
        trials.open_trial(TrialSpec("a", demo, sha256="other"), CONFIG, "given")


def test_a_trial_and_its_parts_can_not_be_changed(demo: Path) -> None:
    """Fails where a stage could hand on a trial other than the one that was opened."""
    trial = trials.open_trial(TrialSpec("a", demo), CONFIG)
    for part in (trial, trial.spec, trial.window, trial.events, trial.reader, trial.robot):
        name = dataclasses.fields(part)[0].name
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(part, name, None)


def test_frames_can_be_read_again_with_the_same_result(demo: Path) -> None:
    """Fails where the first pass over the frames leaves something behind for the second."""
    trial = trials.open_trial(TrialSpec("a", demo, frames=(0, 3)), CONFIG)
    first, second = list(trial.frames()), list(trial.frames())
    assert [f.t_ns for f in first] == [f.t_ns for f in second] == [p.t_ns for p in trial.pairs]
    assert all((a.depth == b.depth).all() for a, b in zip(first, second, strict=True))
    assert trial.n_undecodable_frames == 0


def test_workers_get_the_hashes_that_are_known(
    demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where `dgeval regress` hashes every recording, and each trial hashes it again."""
    got: list[tuple[str, str | None]] = []

    def replayed(spec: TrialSpec, *rest: Any) -> TrialResult:
        got.append((spec.id, rest[5]))
        return TrialResult(spec.id, None, 0, [], None)

    monkeypatch.setattr(workers, "replay_trial", replayed)
    specs = [TrialSpec("a", demo), TrialSpec("b", demo)]
    arguments = (specs, CONFIG, tmp_path, None, True, 1, lambda _: None)
    workers.replay_trials(*arguments, hashes={"a": "known"})
    assert got == [("a", "known"), ("b", None)]


def test_a_flag_is_of_the_newest_frame_by_the_time_it_was_logged() -> None:
    """Fails where a flag that is logged after its frame's processing is taken for the next one's,
    or a frame without one has that of another.
    """
    listed = [(1_020_000_000, 1.0), (1_066_900_000, 0.0), (900_000_000, 1.0), (9_000_000_000, 1.0)]
    scan: Any = SimpleNamespace(numbers={"/dgeval/belief/accepted": listed})
    times = [1_000_000_000, 1_033_000_000, 1_066_000_000]
    assert accepted_flags(scan, times) == {times[0]: True, times[2]: False}
    late = [(t + 50_000_000, float(k != 1)) for k, t in enumerate(times)]  # one for each, 50 ms on
    scan = SimpleNamespace(numbers={"/dgeval/belief/accepted": late})
    assert accepted_flags(scan, times) == {times[0]: True, times[1]: False, times[2]: True}


def test_a_choice_of_another_trial_or_clock_is_none_of_this_one() -> None:
    """Fails where the trial before says that the hand closes, or a grasp without a stamp, or one
    that was logged later than its picture, is known before it was made.
    """
    second = 1_000_000_000
    assert choice_span(100 * second, 110 * second, []) == (90 * second, 110 * second)
    marks = [95 * second, 97 * second, 101 * second]
    assert choice_span(100 * second, 110 * second, marks)[0] == 97 * second
    pose = np.array([0, 0, 0, 0, 0, 0, 1.0])
    robot: Any = SimpleNamespace(base_frame="base")

    def times_of(stamps: list[int], logged: list[int]) -> tuple[int, ...]:
        scan: Any = SimpleNamespace(
            poses={"/dgeval/belief/grasp": [StampedPose(t, "base", "", pose) for t in stamps]},
            times={"/dgeval/belief/grasp": SimpleNamespace(log_ns=logged)},
            candidates=[],
            candidate_scores=[],
            numbers={"/dgeval/belief/execute": [(80 * second, 1.0), (101 * second, 0.0)]},
            recorder_clock=None,
        )
        choices = recorded_choices(scan, (90 * second, 110 * second), robot)
        assert choices.decisions.at(100 * second) is None
        return choices.times

    logged = [85 * second, 101 * second, 102 * second]
    assert times_of(logged, logged) == (101 * second, 102 * second)
    assert times_of([0, 0, 0], logged) == (101 * second, 102 * second)
    assert times_of([t - 50_000_000 for t in logged], logged) == (101 * second, 102 * second)
    assert times_of([t + 86_400 * second for t in logged], logged) == (101 * second, 102 * second)
    stamps = [85 * second, 101 * second, 102 * second]
    other = [t + 86_400 * second for t in stamps]  # a recorder with a clock of its own
    assert times_of(stamps, other) == (101 * second, 102 * second)


def test_the_robots_acceptance_is_asked_for_and_not_there(demo: Path) -> None:
    """Fails where the gate stands in, in silence, for what the log does not have."""
    config = load_config("dynamic", ("registration.accept=recorded",))
    with pytest.raises(UsageError, match="/dgeval/belief/accepted is not recorded"):
        trials.open_trial(TrialSpec("a", demo), config)
