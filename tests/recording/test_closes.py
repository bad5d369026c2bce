"""Catches: the wrong one of several motions of the fingers taken for the close, or its wrong end.

`closing_motion` on widths and heights made of numbers; a 5 s log, looked at every 10 ms.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.recording import closing_motion
from dgeval.recording.closes import close_of
from dgeval.recording.closing_motion import NoClose
from dgeval.recording.events import Events
from dgeval.recording.grippers import GripperTrack
from dgeval.recording.messages import Event

S = 1_000_000_000
LENGTH_S = 5.0


def places(apart: np.ndarray, aside: np.ndarray | float = 0.0) -> np.ndarray:
    """Ends (n, 2, 3) of two fingers at a distance of each other, both shifted aside by m."""
    out = np.zeros((len(apart), 2, 3))
    out[:, 1, 0] = apart
    out[:, :, 1] = np.broadcast_to(aside, len(apart))[:, None]
    return out


def robot(
    monkeypatch: pytest.MonkeyPatch,
    width: list[Any],
    height: list[Any],
    states_s: list[float] | None = None,
    aside: list[Any] | None = None,
) -> Any:
    """A robot whose fingers and palm follow (time s, m) points, linear between them.

    states_s: when a finger's state is recorded. aside: likewise, m, in which both fingers move
    without coming nearer to each other; of a robot whose palm is known.
    """
    times = np.arange(0, int(LENGTH_S * S) + 1, closing_motion.STEP_NS)
    apart = np.interp(times * 1e-9, *zip(*width, strict=True))
    monkeypatch.setattr(closing_motion, "finger_ends", lambda _: ("a", "b"))
    along = 0.0 if aside is None else np.interp(times * 1e-9, *zip(*aside, strict=True))
    monkeypatch.setattr(closing_motion, "_places", lambda *_: (times, places(apart, along)))

    def T_base_palm(t_ns: int) -> np.ndarray:
        T = np.eye(4)
        T[2, 3] = np.interp(t_ns * 1e-9, *zip(*height, strict=True))
        return T

    moving = {}
    if states_s is not None:
        moving["a"] = "palm", SimpleNamespace(times=[round(t * S) for t in states_s])
    tree = SimpleNamespace(moving=moving, ancestors=lambda frame: [frame, "palm"])
    return SimpleNamespace(
        T_base_palm=T_base_palm,
        description=None,
        tree=tree,
        hand_links=("a", "b"),
        palm_frame=None if aside is None else "palm",
    )


def found(made: Any) -> tuple[float, float] | str:
    """Close and lift, s, or why there is none."""
    told = closing_motion.closing_motion(made, 0, int(LENGTH_S * S))
    if isinstance(told, NoClose):
        return told.why
    return told.close_ns / S, told.lift_ns / S


def near(told: tuple[float, float] | str, close_s: float, lift_s: float) -> bool:
    return not isinstance(told, str) and bool(np.allclose(told, (close_s, lift_s), atol=0.06))


OPEN, SHUT, LOW, HIGH = 0.10, 0.04, 0.1, 0.3


def test_a_close_and_a_lift(monkeypatch: pytest.MonkeyPatch) -> None:
    made = robot(
        monkeypatch,
        [(0, OPEN), (2, OPEN), (2.5, SHUT), (5, SHUT)],
        [(0, LOW), (3, LOW), (3.8, HIGH), (5, HIGH)],
    )
    assert near(found(made), 2.0, 3.0)


@pytest.mark.parametrize(("period_s", "told"), [(0.01, 0.01), (0.25, 0.25), (0.5, 0.5)])
def test_a_close_is_as_uncertain_as_its_fingers_states(
    monkeypatch: pytest.MonkeyPatch, period_s: float, told: float
) -> None:
    """Fails where states twice a second place a close to 0.03 s."""
    way = [(0, OPEN), (2, OPEN), (2.5, SHUT), (5, SHUT)], [(0, LOW), (3, LOW), (3.8, HIGH)]
    states = np.arange(0.003, LENGTH_S, period_s).tolist()
    made = closing_motion.closing_motion(robot(monkeypatch, *way, states), 0, int(LENGTH_S * S))
    assert isinstance(made, closing_motion.Inferred)
    assert made.period_s == pytest.approx(told)


@pytest.mark.parametrize("hole", [(1.9, 2.6), (2.2, 2.9), (1.4, 1.98)])
def test_a_close_in_a_hole_of_the_states_is_not_placed(
    monkeypatch: pytest.MonkeyPatch, hole: tuple[float, float]
) -> None:
    """Fails where a lost part of a recording puts the close at the hole's edge."""
    way = [(0, OPEN), (2, OPEN), (2.5, SHUT), (5, SHUT)], [(0, LOW), (3, LOW), (3.8, HIGH)]
    states = [t for t in np.arange(0.0, LENGTH_S, 0.01).tolist() if not hole[0] < t < hole[1]]
    made = closing_motion.closing_motion(robot(monkeypatch, *way, states), 0, int(LENGTH_S * S))
    assert isinstance(made, NoClose)
    assert not made.fingers_seen
    assert "where no states are recorded" in made.why


def test_fingers_that_nobody_saw_for_a_while_may_have_closed_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fails where fingers of which a part of the log knows nothing "never close"."""
    made = robot(monkeypatch, [(0, OPEN), (5, OPEN)], [(0, LOW), (3, LOW), (3.8, HIGH)])
    times = np.concatenate([np.arange(0, 2.0, 0.01), np.arange(3.2, 5.0, 0.01)])
    apart = np.where(times < 2.5, SHUT, OPEN)  # several fingers: closed they may be farther apart
    seen = (times * S).astype(np.int64), places(apart)
    monkeypatch.setattr(closing_motion, "_places", lambda *_: seen)
    told = closing_motion.closing_motion(made, 0, int(LENGTH_S * S))
    assert isinstance(told, NoClose)
    assert "between +1.99 and +3.20 s no states of the fingers are recorded" in told.why
    assert not told.fingers_seen


@pytest.mark.parametrize(
    ("way", "begins_s"),
    [
        ([(1, OPEN), (2, 0.093), (2.2, SHUT)], 2.0),
        ([(1, OPEN), (2, 0.082), (2.08, 0.066), (2.16, 0.065), (2.24, SHUT)], 2.0),
        ([(1, OPEN), (2, 0.075), (2.2, SHUT)], 1.0),
        ([(1.8, OPEN), (1.9, 0.08), (1.98, 0.08), (2.2, SHUT)], 1.8),
    ],
    ids=["gives way, closes", "meets something as it closes", "in two parts", "pauses"],
)
def test_fingers_that_give_way_before_they_close(
    monkeypatch: pytest.MonkeyPatch, way: list[Any], begins_s: float
) -> None:
    """Fails where fingers that lean on the ground have begun to close a second too early, and where
    a close in two parts begins with its second.
    """
    made = robot(
        monkeypatch,
        [(0, OPEN), *way, (5, SHUT)],
        [(0, LOW), (3, LOW), (3.8, HIGH), (5, HIGH)],
    )
    assert near(found(made), begins_s, 3.0)


@pytest.mark.parametrize(("rests", "begins_s"), [(False, 2.0), (True, 2.6)])
def test_fingers_that_curl_past_each_other(
    monkeypatch: pytest.MonkeyPatch, rests: bool, begins_s: float
) -> None:
    """Fails where fingers whose tips draw apart for a while, as they curl on, closed only then; and
    where what fingers did before they rested is of the close.
    """
    aside = [(0, 0.0), (2, 0.0), (2.2, 0.03), (2.6, 0.03 if rests else 0.09), (5, 0.09)]
    made = robot(
        monkeypatch,
        [(0, OPEN), (2, OPEN), (2.2, 0.07), (2.6, 0.08), (2.8, SHUT), (5, SHUT)]
        if not rests
        else [(0, OPEN), (2, OPEN), (2.2, 0.07), (2.6, 0.07), (2.8, SHUT), (5, SHUT)],
        [(0, LOW), (3, LOW), (3.8, HIGH), (5, HIGH)],
        aside=aside,
    )
    assert near(found(made), begins_s, 3.0)
    told = closing_motion.closing_motion(made, 0, int(LENGTH_S * S))
    assert isinstance(told, closing_motion.Inferred)
    assert told.earlier_ns == ()


def test_a_lift_right_behind_a_slow_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where the time to the lift is taken from the fingers' rest and not from their start."""
    made = robot(
        monkeypatch,
        [(0, OPEN), (2, OPEN), (3, SHUT), (5, SHUT)],
        [(0, LOW), (3.05, LOW), (3.8, HIGH), (5, HIGH)],
    )
    assert near(found(made), 2.0, 3.05)


def test_the_last_of_two_attempts_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    made = robot(
        monkeypatch,
        [(0, OPEN), (0.5, OPEN), (0.8, SHUT), (2, SHUT), (2.3, OPEN), (3, OPEN), (3.3, SHUT),
         (5, SHUT)],
        [(0, LOW), (1.0, LOW), (1.5, HIGH), (2.2, HIGH), (2.8, LOW), (3.6, LOW), (4.2, HIGH),
         (5, HIGH)],
    )  # fmt: skip
    assert near(found(made), 3.0, 3.6)


def test_a_lift_long_after_is_not_of_this_close(monkeypatch: pytest.MonkeyPatch) -> None:
    made = robot(
        monkeypatch,
        [(0, OPEN), (1, OPEN), (1.3, SHUT), (5, SHUT)],
        [(0, LOW), (2.7, LOW), (3.1, HIGH), (5, HIGH)],
    )
    assert "does not rise" in str(found(made))


def test_a_slow_rise_is_no_lift(monkeypatch: pytest.MonkeyPatch) -> None:
    made = robot(
        monkeypatch,
        [(0, OPEN), (1, OPEN), (1.3, SHUT), (5, SHUT)],
        [(0, LOW), (1.5, LOW), (5, LOW + 0.09)],
    )
    assert "does not rise" in str(found(made))


def test_fingers_that_pause_at_the_object_close_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where the second half of a close, after a pause of 0.2 s, is taken for the close."""
    made = robot(
        monkeypatch,
        [(0, OPEN), (2, OPEN), (2.3, 0.07), (2.5, 0.07), (2.8, SHUT), (5, SHUT)],
        [(0, LOW), (3.1, LOW), (3.7, HIGH), (5, HIGH)],
    )
    assert near(found(made), 2.0, 3.1)


def test_fingers_that_slip_as_the_palm_rises_do_not_close(monkeypatch: pytest.MonkeyPatch) -> None:
    made = robot(
        monkeypatch,
        [(0, OPEN), (1, OPEN), (1.3, 0.06), (2.0, 0.06), (2.2, SHUT), (5, SHUT)],
        [(0, LOW), (1.95, LOW), (2.5, HIGH), (5, HIGH)],
    )
    assert near(found(made), 1.0, 1.95)


@pytest.mark.parametrize("ended", [True, False])
def test_a_hand_that_stays_open(monkeypatch: pytest.MonkeyPatch, ended: bool) -> None:
    """Fails where fingers that are known throughout are no fact without the robot's own events."""
    made = robot(monkeypatch, [(0, OPEN), (5, OPEN)], [(0, LOW), (5, LOW)])
    entries = (Event(4 * S, "trial_end", {}),) if ended else ()
    known = close_of(Events(entries), made, 0, 5 * S)
    assert (known.source, known.missing) == (None, None)


def test_a_gripper_that_is_told_to_move_may_have_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where fingers that stand still outweigh a command that the palm does not rise after."""
    made = robot(monkeypatch, [(0, OPEN), (5, OPEN)], [(0, LOW), (5, LOW)])
    times = np.array([1 * S, 2 * S, 3 * S, 4 * S], dtype=np.int64)
    told = GripperTrack("/gripper/command", "command", times, np.array([0.1, 0.1, 0.0, 0.0]))
    known = close_of(Events(()), made, 0, 5 * S, grippers=(told,))
    assert known.source is None
    assert known.missing is not None


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_fingers_known_half_the_time_are_not_known(
    monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """Fails where fingers that nobody saw in the other half are said never to have closed."""
    made = robot(monkeypatch, [(0, OPEN), (5, OPEN)], [(0, LOW), (5, LOW)])
    times = np.arange(0, int(LENGTH_S * S * share) + 1, closing_motion.STEP_NS)
    seen = times, places(np.full(len(times), OPEN))
    monkeypatch.setattr(closing_motion, "_places", lambda *_: seen)
    known = close_of(Events((Event(4 * S, "trial_end", {}),)), made, 0, 5 * S)
    assert (known.missing is None) == (share == 1.0)


def test_a_motion_without_a_lift_is_said_where_no_close_is_marked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fails where fingers that moved are passed over when a trial is called one without a close."""
    made = robot(
        monkeypatch,
        [(0, OPEN), (2, OPEN), (2.5, SHUT), (5, SHUT)],
        [(0, LOW), (5, LOW)],
    )
    known = close_of(Events((Event(4 * S, "trial_end", {}),)), made, 0, 5 * S)
    assert (known.source, known.missing) == (None, None)
    assert "+2.0" in known.note
    assert "--close" in known.note


def test_of_several_attempts_the_last_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where the first of several closes is judged by how the trial ended, or one is dropped
    without a word.
    """
    shapes = (OPEN, OPEN, SHUT, SHUT, OPEN, OPEN, SHUT, SHUT)
    heights = (LOW, LOW, HIGH, HIGH, LOW, LOW, HIGH, HIGH)
    made = robot(
        monkeypatch,
        list(zip((0, 1, 1.4, 2.6, 2.8, 3, 3.4, 5), shapes, strict=True)),
        list(zip((0, 1.5, 1.9, 2.6, 2.9, 3.6, 4.2, 5), heights, strict=True)),
    )
    assert near(found(made), 3.0, 3.6)
    known = close_of(Events(()), made, 0, 5 * S)
    assert "other attempts at +1.0" in known.note
    assert known.before_ns == 1 * S
    closes = [Event(t * S, "close", {}) for t in (1, 3)]
    lifts = [Event(t * S // 10, "lift", {}) for t in (15, 36)]
    entries = tuple(sorted([*closes, *lifts], key=lambda e: e.t_ns))
    told = close_of(Events(entries), made, 0, 5 * S)
    assert (told.source, told.events.first_ns("close")) == ("event", 3 * S)
    assert told.events.first_ns("lift") == 3.6 * S
    assert told.before_ns == 1 * S
    assert "other attempts at +1.00 s" in told.note


def test_a_gripper_that_closes_empty_after_the_last_lift_decides_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fails where the close of a hand that goes home is judged."""
    made = robot(monkeypatch, [(0, OPEN), (5, OPEN)], [(0, LOW), (5, LOW)])
    entries = (Event(1 * S, "close", {}), Event(2 * S, "lift", {}), Event(4 * S, "close", {}))
    told = close_of(Events(entries), made, 0, 5 * S)
    assert told.events.first_ns("close") == 1 * S


def test_fingers_that_tremble_close_when_they_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where 0.25 mm of noise beside a motion of 7 mm is one close from the first frame on."""
    t = np.arange(0.0, LENGTH_S + 0.01, 0.01)
    noise = np.random.default_rng(0).normal(0, 2.5e-4, len(t))
    width = np.interp(t, [3.0, 3.1], [0.104, 0.0975]) + noise
    made = robot(
        monkeypatch,
        list(zip(t.tolist(), width.tolist(), strict=True)),
        [(0, 0.5), (2.9, LOW), (3.7, LOW), (4.3, HIGH), (5, HIGH)],
    )
    assert near(found(made), 3.0, 3.7)


@pytest.mark.parametrize(
    ("ends", "released_s"),
    [
        ([(4, SHUT), (4.4, OPEN), (5, OPEN)], 4.0),  # put down
        ([(5, SHUT)], None),
        ([(4, SHUT), (4.1, 0.05), (5, 0.05)], None),  # gives way a little as it is lifted
        ([(3.5, OPEN), (4.0, SHUT), (5, SHUT)], None),  # closed again
    ],
)
def test_a_hand_that_opens_again(
    monkeypatch: pytest.MonkeyPatch, ends: list[Any], released_s: float | None
) -> None:
    """Fails where what was put down on purpose was never held."""
    made = robot(monkeypatch, [(0, OPEN), (2, OPEN), (2.5, SHUT), (3, SHUT), *ends], [(0, LOW)] * 2)
    times, ends_of = closing_motion._places(made, ("a", "b"), 0, int(LENGTH_S * S))
    after = times >= 2 * S
    seen = times[after], ends_of[after]
    monkeypatch.setattr(closing_motion, "_places", lambda *_: seen)
    found_ns = closing_motion.release_after(made, 2 * S, int(LENGTH_S * S))
    if released_s is None:
        assert found_ns is None
    else:
        assert found_ns is not None
        assert abs(found_ns / S - released_s) < 0.06


def test_a_lift_without_a_close_is_no_hand_that_never_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fails where a log that begins after the close tells that the hand never closed."""
    made = robot(monkeypatch, [(0, SHUT), (5, SHUT)], [(0, LOW), (1, HIGH), (5, HIGH)])
    marked = [Event(S, "lift", {}), Event(4 * S, "trial_end", {})]
    known = close_of(Events(tuple(marked)), made, 0, 5 * S)
    assert known.missing is not None
    assert "does the log begin after it" in known.missing
    never = close_of(Events(tuple(marked[1:])), made, 0, 5 * S)
    assert never.missing is None


@pytest.mark.parametrize(("marked_s", "is_told"), [(1.0, True), (1.8, False), (2.0, False)])
def test_a_close_that_is_marked_long_before_the_fingers_move(
    monkeypatch: pytest.MonkeyPatch, marked_s: float, is_told: bool
) -> None:
    made = robot(
        monkeypatch,
        [(0, OPEN), (2, OPEN), (2.5, SHUT), (5, SHUT)],
        [(0, LOW), (3, LOW), (3.8, HIGH), (5, HIGH)],
    )
    known = close_of(Events((Event(round(marked_s * S), "close", {}),)), made, 0, 5 * S)
    assert ("if the mark is early: --close +2.0" in known.note) == is_told


def test_the_bars_of_a_linkage_hide_no_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where jaws that close by 6 mm on a wide thing "hardly move", as four bars that hang on
    them stay where they are.
    """
    made = robot(monkeypatch, [(0, OPEN)], [(0, LOW), (3, LOW), (3.8, HIGH), (5, HIGH)])
    times = np.arange(0, int(LENGTH_S * S) + 1, closing_motion.STEP_NS)
    ends = np.zeros((len(times), 6, 3))
    ends[:, 1, 0] = np.interp(times * 1e-9, [0, 2, 2.3, 5], [0.085, 0.085, 0.079, 0.079])
    ends[:, 2:, 1] = [0.05, 0.06, 0.07, 0.08]
    monkeypatch.setattr(closing_motion, "_places", lambda *_: (times, ends))
    assert near(found(made), 2.0, 3.0)


@pytest.mark.parametrize(("lift_s", "released_s"), [(2.8, 4.0), (4.6, None), (None, None)])
def test_a_hand_that_opens_and_closes_again_after_its_lift(
    monkeypatch: pytest.MonkeyPatch, lift_s: float | None, released_s: float | None
) -> None:
    """Fails where a hand that put something down and closed for its way home held nothing; and
    where one that opened before the lift let go.
    """
    way = [(2, OPEN), (2.5, SHUT), (4, SHUT), (4.2, OPEN), (4.5, OPEN), (4.7, SHUT), (5, SHUT)]
    made = robot(monkeypatch, way, [(0, LOW)] * 2, aside=[(0, 0.0), (5, 0.0)])
    times, ends = closing_motion._places(made, ("a", "b"), 0, int(LENGTH_S * S))
    monkeypatch.setattr(closing_motion, "_places", lambda *_: (times[200:], ends[200:]))
    lift_ns = None if lift_s is None else round(lift_s * S)
    found_ns = closing_motion.release_after(made, 2 * S, int(LENGTH_S * S), lift_ns)
    assert (found_ns is None) == (released_s is None)
    assert found_ns is None or abs(found_ns / S - released_s) < 0.06


def test_a_hand_opens_whatever_shape_it_opens_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where fingers that go to their shape at rest, their tips no farther apart than those of
    the grip, are closed to the end.
    """
    made = robot(monkeypatch, [(0, OPEN)], [(0, LOW)] * 2, aside=[(0, 0.0), (5, 0.0)])
    times = np.arange(2 * S, 5 * S + 1, closing_motion.STEP_NS)
    ends = np.zeros((len(times), 2, 3))
    ends[:, 0, 0] = np.interp(times / S, [2, 2.5, 4, 4.3, 5], [-0.05, -0.02, -0.02, -0.05, -0.05])
    ends[:, 1, 0] = np.interp(times / S, [2, 2.5, 4, 4.3, 5], [0.05, 0.02, 0.02, 0.03, 0.03])
    ends[:, 1, 0] -= np.interp(times / S, [4, 4.3], [0.0, 0.02])
    ends[:, 1, 2] = np.interp(times / S, [2, 2.5, 4, 4.3, 5], [0.04, 0.0, 0.0, 0.04, 0.04])
    monkeypatch.setattr(closing_motion, "_places", lambda *_: (times, ends))
    width = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    assert width[-1] - width[150] < 0.6 * (width[0] - width[150])
    found_ns = closing_motion.release_after(made, 2 * S, 5 * S)
    assert found_ns is not None
    assert abs(found_ns / S - 4.0) < 0.06
