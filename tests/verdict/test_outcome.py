"""How a trial ended, from an operator's label, fingers and sightings, each just under and just
over its line.

Catches: a label that loses against the log, a hand that never closed judged by what the robot
recorded of its plans, a log that ends at the close and is judged all the
same, efforts of one finger or of a moment taken for a grip, jaws that meet taken for held,
sightings that jump about believed, and a contradiction decided.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config
from dgeval.geometry import Array
from dgeval.hindsight.smoothing import Sighting
from dgeval.perception.plane import Plane
from dgeval.recording.contract import GIVE_A_LABEL
from dgeval.recording.events import Events
from dgeval.recording.messages import Event, JointSample
from dgeval.recording.pairing import Pair
from dgeval.recording.scan import TopicTimes
from dgeval.verdict.log import log_of
from dgeval.verdict.outcome import Ended, outcome_of

OUTCOME = "dgeval.verdict.outcome"
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
CLOSE = START + 2 * SECOND
FINGERS = ("thumb", "index", "middle", "ring", "little")
FLEXION = tuple(f"{finger}_{k}" for finger in FINGERS for k in (1, 2))
JAWS = ("left_jaw", "right_jaw")


def at(seconds: float) -> int:
    """Time of the log, ns, from seconds after the close."""
    return CLOSE + round(seconds * SECOND)


def trial(
    events: Sequence[Event] = (),
    joints: Sequence[JointSample] = (),
    last_s: float = 4.0,
    closed: bool = True,
    label: str | None = None,
    end_s: float | None = None,
    damage: Sequence[str] = (),
    missing: str | None = None,
    motion_ns: int | None = None,
    checks: Sequence[str] = (),
    palm_known: float = 1.0,
    palm_speed: float = 0.1,
    ended: bool = True,
    gripper: dict[str, list[tuple[int, float]]] | None = None,
) -> Any:
    """A trial whose last frame is `last_s` after the close; the log of the joints is as given.

    ended: whether its end is marked. gripper: time, ns, and number, by topic of a command.
    """
    last_ns = at(last_s)

    def T_base_palm(t_ns: int) -> Array | None:
        T = np.eye(4)
        T[2, 3] = palm_speed * (t_ns - START) * 1e-9
        return T if t_ns - START <= palm_known * (last_ns - START) else None

    every = [*events, *([Event(CLOSE, "close", {})] if closed else [])]
    every += [Event(last_ns, "trial_end", {})] if ended else []
    known = {name: SimpleNamespace(type="std_msgs/msg/Float64") for name in gripper or {}}
    return SimpleNamespace(
        spec=SimpleNamespace(label=label, end_ns=None if end_s is None else at(end_s)),
        events=Events(tuple(every)),
        event_ns=lambda kind: next((e.t_ns for e in every if e.kind == kind), None),
        damage=list(damage),
        # `hand_distance` is replaced where it counts
        robot=SimpleNamespace(
            samples=tuple(joints),
            T_base_palm=T_base_palm,
            hand_shapes=lambda t_ns: None,
            T_base_camera=lambda t_ns: None,
            description=None,
            joints=SimpleNamespace(times={}, values={}),
        ),
        roles=SimpleNamespace(colour="/colour"),
        pairs=[Pair(START, 0, 0), Pair(last_ns, 1, 1)],
        scan=SimpleNamespace(
            poses={},
            times={},
            twists={},
            grippers=gripper or {},
            opened=SimpleNamespace(topics=known),
        ),
        config=Config(),
        opened=None,
        close=SimpleNamespace(missing=missing, motion_ns=motion_ns),
        checks=[SimpleNamespace(name=name) for name in checks],
        untested=(),
    )


def outcome(made: Any, hindsight: Any) -> Ended:
    """How the trial ended, from what its log says."""
    return outcome_of(log_of(made), hindsight)


def efforts(*by_finger: float, last_s: float = 4.0, n: int = 20) -> list[JointSample]:
    """Samples every 20 ms up to the end; each finger presses with its second flexion joint, Nm."""
    values = dict.fromkeys(FLEXION, 0.0) | {
        f"{f}_2": e for f, e in zip(FINGERS, by_finger, strict=False)
    }
    return [
        JointSample(at(last_s - 0.02 * k), dict.fromkeys(values, 0.5), values)
        for k in reversed(range(n))
    ]


def jaws(left_m: float, right_m: float, last_s: float = 4.0, n: int = 20) -> list[JointSample]:
    positions = dict(zip(JAWS, (left_m, right_m), strict=True))
    return [JointSample(at(last_s - 0.02 * k), positions) for k in reversed(range(n))]


EMPTY, GRIP = efforts(0.01, -0.01, 0.0, 0.0, 0.0), efforts(0.30, -0.20, 0.0, 0.0, 0.0)
EMPTY_SAYS = "the fingers hold nothing at the end (0.01, 0.01, 0.00, 0.00, 0.00 Nm)"
GRIP_SAYS = "2 fingers still press at the end (0.30, 0.20, 0.00, 0.00, 0.00 Nm)"
NOTHING_SAID = Ended(
    "unknown",
    None,
    "neither efforts nor a sighting after the lift say how it ended; an operator's word does: "
    "--label success or --label failure",
)

# labels


@pytest.mark.parametrize("label", ["success", "failure"])
@pytest.mark.parametrize("joints", [EMPTY, GRIP])
def test_an_operators_label_wins(label: str, joints: list[JointSample]) -> None:
    """Catches a log that overrules the operator, a label read the other way round, and fingers that
    say the other and are not named.
    """
    said = "an operator's label says so"
    told = Ended(label, "label", said)  # type: ignore[arg-type]
    assert outcome(trial(closed=False, label=label, damage=["torn"]), None) == told, (
        "without a close too"
    )
    if (label == "success") != (joints is GRIP):
        told = replace(
            told, evidence=f"{said}, though {GRIP_SAYS if joints is GRIP else EMPTY_SAYS}"
        )
    assert outcome(trial(joints=joints, label=label), None) == told
    event = Event(at(3.0), "label", {"label": label})
    assert outcome(trial([event], joints), None) == told


def test_the_manifests_label_goes_before_the_logs() -> None:
    """Catches a correction in the manifest that has no effect."""
    event = Event(at(3.0), "label", {"label": "failure"})
    assert outcome(trial([event], label="success"), None).outcome == "success"


def test_labels_that_contradict_each_other_are_no_label() -> None:
    """Catches one of them taken: it may be the word on the trial before."""
    events = [
        Event(at(k), "label", {"label": label}) for k, label in ((3, "failure"), (4, "success"))
    ]
    assert outcome(trial(events), None).outcome == "unknown"


@pytest.mark.parametrize("label", [None, "maybe", 1])
def test_a_label_that_says_neither_is_passed_over(label: object) -> None:
    """Catches any label but "success" taken for a failure."""
    event = Event(at(3.0), "label", {} if label is None else {"label": label})
    assert outcome(trial([event], GRIP), None).source == "inferred"


# without a close, the fingers known never to have closed

END = Event(at(4.0), "trial_end", {})


def near_to(nearest_m: float | None) -> Any:
    """Hindsight of a trial in which the hand came so near, m."""
    path = SimpleNamespace(at=lambda t_ns: np.eye(4))
    return SimpleNamespace(nearest_m=nearest_m, path=path, points=np.zeros((1, 3)))


@pytest.mark.parametrize(("nearest_m", "told"), [(0.079, "failure"), (0.081, "no_grasp")])
def test_near_and_never_closed_is_a_failure(nearest_m: float, told: str) -> None:
    """Catches another line, and an answer that depends on what the robot recorded of its plans."""
    found = outcome(trial(closed=False), near_to(nearest_m))
    assert (found.outcome, found.source) == (told, "inferred")
    assert found.p_success == (0.0 if told == "failure" else None)
    assert outcome(trial([END], closed=False), near_to(nearest_m)) == found


@pytest.mark.parametrize(("first_m", "told"), [(0.079, "unknown"), (0.081, "failure")])
def test_a_log_that_begins_at_the_object_may_begin_after_the_close(
    monkeypatch: pytest.MonkeyPatch, first_m: float, told: str
) -> None:
    """Fails where a recorder that starts late makes "never closed" of a close before it."""
    monkeypatch.setattr(f"{OUTCOME}.hand_distance", lambda *of: (first_m, "index"))
    found = outcome(trial(closed=False), near_to(0.01))
    assert found.outcome == told
    assert ("does the log begin after the close?" in found.evidence) == (told == "unknown")


@pytest.mark.parametrize(
    ("rises", "what", "told"),
    [
        (0.1, "nothing", "unknown"),
        (0.0, "nothing", "failure"),
        (0.1, "position", "failure"),
        (0.1, "effort", "failure"),
    ],
)
def test_fingers_that_nothing_is_heard_of_never_closed_by_no_proof(
    rises: float, what: str, told: str
) -> None:
    """Fails where a driver that hangs, and repeats its first states, makes a failure "never closed"
    of a success: the palm came near and rose.
    """
    states = [
        JointSample(
            at(-2 + 0.02 * k),
            {"index": 0.5 + (k == 40 and what == "position") * 1e-9},
            {"index": 0.1 + (k == 40 and what == "effort") * 1e-9},
        )
        for k in range(300)
    ]
    made = trial(joints=states, closed=False, palm_speed=rises)
    made.robot.description = SimpleNamespace()
    made.robot.hand = SimpleNamespace(joints=("index",))
    found = outcome(made, near_to(0.01))
    assert found.outcome == told
    assert ("does their driver hang?" in found.evidence) == (told == "unknown")


@pytest.mark.parametrize(
    ("seen", "rises", "near_m", "told"),
    [
        ((True, "the object is seen 20 cm up"), True, 0.05, "unknown"),
        (None, True, 0.05, "unknown"),
        ((False, "the object is seen left"), True, 0.05, "failure"),
        (None, True, 0.2, "failure"),  # it rose from somewhere else
        (None, False, 0.05, "failure"),
    ],
)
def test_a_hand_that_rises_from_the_object_may_have_closed_on_it(
    monkeypatch: pytest.MonkeyPatch,
    seen: tuple[bool, str] | None,
    rises: bool,
    near_m: float,
    told: str,
) -> None:
    """Fails where a gripper whose jaws hardly move on a wide object "never closed"."""
    made = trial(closed=False)

    def T_base_palm(t_ns: int) -> Array:
        T = np.eye(4)
        T[2, 3] = max(0.4 - 0.2 * (t_ns - START) * 1e-9, 0.1)
        T[2, 3] += max(0.2 * (t_ns - at(1.0)) * 1e-9, 0.0) * rises
        return T

    made.robot.T_base_palm = T_base_palm
    far_at_first = lambda _, t_ns, points: (0.3 if t_ns == START else near_m, "index")  # noqa: E731
    monkeypatch.setattr(f"{OUTCOME}.hand_distance", far_at_first)
    monkeypatch.setattr(f"{OUTCOME}._seen_after", lambda *of: seen)
    found = outcome(made, near_to(0.01))
    assert found.outcome == told
    assert ("--close TIME" in found.evidence) == (told == "unknown")
    if seen is not None and told == "unknown":
        assert seen[1] in found.evidence


@pytest.mark.parametrize(
    ("motion_s", "near_at_s", "told"),
    [(-1.8, -1.0, "failure"), (-0.5, -1.0, "unknown"), (None, -1.0, "unknown")],
)
def test_fingers_that_move_far_from_the_object_take_a_shape(
    monkeypatch: pytest.MonkeyPatch, motion_s: float | None, near_at_s: float, told: str
) -> None:
    """Fails where fingers that take their shape two seconds before the hand is at the object hide
    that it never closed there.
    """
    motion_ns = None if motion_s is None else at(motion_s)
    made = trial(closed=False, missing="fingers close", motion_ns=motion_ns, palm_speed=0.0)
    made.robot.T_base_palm = lambda t_ns: np.diag([1.0, 1.0, 1.0, 1.0])
    comes = lambda _, t_ns, points: (0.05 if t_ns >= at(near_at_s) else 0.3, "index")  # noqa: E731
    monkeypatch.setattr(f"{OUTCOME}.hand_distance", comes)
    found = outcome(made, near_to(0.05))
    assert found.outcome == told
    assert (found.evidence == "fingers close") == (told == "unknown")
    assert outcome(made, None).outcome == "unknown"


@pytest.mark.parametrize("hindsight", [None, near_to(None)])
def test_a_target_that_is_not_known_is_no_answer(hindsight: Any) -> None:
    """Catches `no_grasp` said of a hand that moved to a target which was never tracked."""
    found = outcome(trial(closed=False), hindsight)
    assert (found.outcome, found.source) == ("unknown", None)
    assert "how near it came to the target is not known" in found.evidence
    still = outcome(trial(closed=False, palm_speed=0.0), hindsight)
    assert still.outcome == "no_grasp", "a hand that never moved grasps nothing"


@pytest.mark.parametrize(
    ("known", "told"), [(0.91, "no_grasp"), (0.89, "unknown"), (0.0, "unknown")]
)
def test_a_hand_that_is_not_known_is_no_answer(known: float, told: str) -> None:
    """Catches "never came near" said of a palm whose pose is recorded for part of the trial."""
    assert outcome(trial(closed=False, palm_known=known), near_to(0.5)).outcome == told


def test_fingers_that_are_not_known_are_no_answer() -> None:
    """Catches `no_grasp` said where nobody knows what the fingers did."""
    found = outcome(trial(closed=False, missing="no moment of closing is marked"), near_to(0.5))
    assert found == Ended("unknown", None, "no moment of closing is marked")


def test_damage_goes_before_what_is_missing() -> None:
    """Catches a close that can't be read taken for one that never came."""
    told = Ended(
        "incomplete",
        None,
        "a part of the recording is damaged or missing, and what can be read has no close",
    )
    assert outcome(trial([END], closed=False, damage=["torn"]), None) == told
    assert outcome(trial(closed=False, damage=["torn"]), None) == told
    assert outcome(trial(closed=False, checks=["parts"]), near_to(0.5)) == told
    assert outcome(trial(joints=EMPTY, damage=["torn"]), None).outcome == "failure", (
        "the close was read"
    )


# the end of the log


@pytest.mark.parametrize(
    ("last_s", "told"), [(0.0, "0.0"), (0.64, "0.6"), (0.99, "1.0"), (-0.5, "0.0")]
)
def test_a_log_that_ends_at_the_close_says_nothing(last_s: float, told: str) -> None:
    """Catches fingers judged while they close, and a negative time told."""
    found = outcome(trial(joints=efforts(0.3, 0.3, last_s=last_s), last_s=last_s), None)
    assert found == Ended("unknown", None, f"the log ends {told} s after the close")


def test_from_one_second_on_the_fingers_are_at_rest() -> None:
    """Catches `<=` for `<`."""
    joints = efforts(0.3, 0.2, last_s=1.0)
    assert outcome(trial(joints=joints, last_s=1.0), None).outcome == "success"


def test_joints_that_outlast_the_frames_count_up_to_the_trials_end() -> None:
    """Catches joints of the next trial, and a log judged by its last frame alone."""
    joints = [*efforts(0.0, 0.0, last_s=2.0), *efforts(0.3, 0.2, last_s=3.0)]
    frames_end = trial(joints=joints, last_s=0.2, end_s=3.0)
    assert outcome(frames_end, None).evidence == GRIP_SAYS
    assert outcome(trial(joints=joints, last_s=0.2, end_s=2.5), None).outcome == "failure"
    ended = Ended("unknown", None, "the log ends 0.2 s after the close")
    assert outcome(trial(joints=joints, last_s=0.2, end_s=0.9), None) == ended
    assert outcome(trial(joints=joints, last_s=0.2), None) == ended


# fingers


def test_fingers_that_press() -> None:
    """Catches a sign of effort that matters, confidence of a failure for one of a success, fingers
    listed out of order.
    """
    assert outcome(trial(joints=GRIP), None) == Ended("success", "inferred", GRIP_SAYS, 0.97, True)
    found = outcome(trial(joints=EMPTY), None)
    assert (found.outcome, found.source, found.evidence) == ("failure", "inferred", EMPTY_SAYS)
    assert found.p_success == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("by_finger", "held"),
    [
        ((0.051, 0.051, 0, 0, 0), True),
        ((0.051, 0.049, 0, 0, 0), False),
        ((0.9, 0.0, 0, 0, 0), False),  # one finger alone holds nothing
        ((0.0, 0.0, 0.0, 0.06, 0.06), True),
    ],
)
def test_two_fingers_with_more_than_0_05_nm_hold(by_finger: tuple[float, ...], held: bool) -> None:
    """Catches another line, and one finger taken for a grip."""
    assert outcome(trial(joints=efforts(*by_finger)), None).outcome == (
        "success" if held else "failure"
    )


def test_both_flexion_joints_of_a_finger_are_looked_at() -> None:
    """Catches joints paired across fingers: two joints of one finger are one finger."""
    values = dict.fromkeys(FLEXION, 0.0) | {"index_1": 0.2, "index_2": 0.2}
    one = [JointSample(at(4 - 0.02 * k), {}, values) for k in reversed(range(20))]
    assert outcome(trial(joints=one), None).outcome == "failure"
    values = dict.fromkeys(FLEXION, 0.0) | {"index_1": 0.2, "middle_1": 0.2}
    two = [JointSample(at(4 - 0.02 * k), {}, values) for k in reversed(range(20))]
    assert outcome(trial(joints=two), None).outcome == "success"


def test_efforts_that_are_zero_all_the_time_are_none() -> None:
    """Fails where a driver that fills efforts with zeros makes a failure of every success."""
    zeros = dict.fromkeys(FLEXION, 0.0)
    joints = [JointSample(at(4 - 0.02 * k), {}, zeros) for k in reversed(range(20))]
    assert outcome(trial(joints=joints), None).outcome == "unknown"


def test_efforts_that_no_drive_gives_are_in_other_units() -> None:
    """Fails where currents in mA, whose noise passes every threshold in Nm, make a failure a
    success.
    """
    found = outcome(trial(joints=efforts(210.0, 140.0, 7.0, 7.0, 7.0)), None)
    assert found.outcome == "unknown"
    assert "the fingers' efforts reach 210, more than this hand's 10 Nm" in found.evidence


def test_efforts_of_abduction_are_not_a_grip() -> None:
    """Catches fingers that are spread apart taken for ones that press."""
    spread = dict.fromkeys(FLEXION, 0.001) | {f"{f}_0": 0.5 for f in FINGERS}
    joints = [JointSample(at(4 - 0.02 * k), {}, spread) for k in reversed(range(20))]
    assert outcome(trial(joints=joints), None).outcome == "failure"


def test_efforts_are_judged_by_their_mean_over_the_last_half_second() -> None:
    """Catches lengths averaged instead of efforts, and efforts of the lift that are long gone."""
    swinging = [
        s
        for k in range(10)
        for s in efforts(0.3 * (-1) ** k, 0.3 * (-1) ** k, last_s=4 - 0.02 * k, n=1)
    ][::-1]
    assert outcome(trial(joints=swinging), None).outcome == "failure"
    dropped = [*efforts(0.3, 0.3, last_s=3.4, n=50), *efforts(0.0, 0.0, last_s=4.0, n=25)]
    further = [replace(s, positions=dict.fromkeys(s.positions, 0.6)) for s in dropped[50:]]
    assert outcome(trial(joints=[*dropped[:50], *further]), None).outcome == "failure"
    # fingers that stay where they pressed have not lost what they held: a brake holds them
    braked = outcome(trial(joints=dropped), None)
    assert braked.outcome == "unknown"
    assert "fall away while the fingers stay where they are" in braked.evidence


def test_equal_efforts_of_all_fingers_are_commanded_ones() -> None:
    """Fails where the current that a driver was told to give is what fingers press with."""
    told = [
        JointSample(s.t_ns, s.positions, dict.fromkeys(s.positions, 0.3)) for s in efforts(0.3, 0.3)
    ]
    found = outcome(trial(joints=told), None)
    assert found.outcome == "unknown"
    assert "one number to the last digit" in found.evidence
    measured = [replace(s, efforts={**s.efforts, "index_2": 0.31}) for s in told]
    assert outcome(trial(joints=measured), None).outcome == "success"


@pytest.mark.parametrize(("n", "said"), [(4, False), (5, True)])
def test_fewer_than_five_samples_say_nothing(n: int, said: bool) -> None:
    """Catches a single sample believed."""
    found = outcome(trial(joints=efforts(0.3, 0.3, n=n)), None)
    assert found == NOTHING_SAID if not said else found.outcome == "success"


def test_samples_without_efforts_say_nothing() -> None:
    """Catches missing efforts taken for 0, in all joints or in one."""
    silent = [JointSample(s.t_ns, s.positions) for s in GRIP]
    assert outcome(trial(joints=silent), None) == NOTHING_SAID
    partly = [
        JointSample(s.t_ns, s.positions, {n: e for n, e in s.efforts.items() if n != "ring_1"})
        for s in GRIP
    ]
    assert outcome(trial(joints=partly), None) == NOTHING_SAID
    assert outcome(trial(), None) == NOTHING_SAID


# jaws


@pytest.mark.parametrize(
    ("left_m", "right_m", "held", "said"),
    [
        (0.0011, 0.0010, True, "the jaws are 2 mm apart at the end"),
        (0.0010, 0.0009, False, "the jaws are 2 mm apart at the end: they hold nothing"),
        (0.020, 0.015, True, "the jaws are 35 mm apart at the end"),
        (0.0, 0.0, False, "the jaws are 0 mm apart at the end: they hold nothing"),
    ],
)
def test_jaws_hold_what_keeps_them_2_mm_apart(
    left_m: float, right_m: float, held: bool, said: str
) -> None:
    """Catches one jaw's position taken for their distance, and the line for one of them."""
    found = outcome(trial(joints=jaws(left_m, right_m)), None)
    assert (found.outcome, found.evidence) == ("success" if held else "failure", said)
    assert found.p_success == pytest.approx(0.97 if held else 0.03)


def test_jaws_are_judged_by_their_median() -> None:
    """Catches a single sample of a bouncing jaw, as the last is here, believed."""
    joints = [*jaws(0.0, 0.0, last_s=3.98), *jaws(0.04, 0.04, n=1)]
    assert outcome(trial(joints=joints), None).outcome == "failure"


def test_one_jaw_alone_says_nothing() -> None:
    """Catches a missing joint taken for one at 0."""
    joints = [JointSample(s.t_ns, {"left_jaw": 0.02}) for s in jaws(0.02, 0.02)]
    assert outcome(trial(joints=joints), None) == NOTHING_SAID


# sightings: the support is z = 0, and at the close the object's middle is at rest at z = 0.06

CENTRE = np.array([0.0, 0.0, 0.01])
Seen = Callable[..., Any]


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> Seen:
    """Hindsight with sightings every 0.1 s at these heights above where it rested, m; the hand is
    so far from the last.
    """

    def made(
        rises: Sequence[float],
        hand_m: float | None = 0.5,
        first_s: float = 2.0,
        by: str = "registration",
        support: bool = True,
        before: int = 20,
    ) -> Any:
        T_rest = np.eye(4)
        T_rest[2, 3] = 0.05
        sightings = []
        for k, rise in enumerate(rises):
            T = T_rest.copy()
            T[:3, 3] += [0.3, 0.0, rise]
            sightings.append(Sighting(at(first_s + 0.1 * k), T, by))  # type: ignore[arg-type]

        def hand_distance(_: object, t_ns: int, points: Array) -> tuple[float, str] | None:
            assert t_ns == sightings[-1].t_ns
            np.testing.assert_allclose(points, [[0.3, 0.0, 0.06 + rises[-1]]], atol=1e-12)
            return None if hand_m is None else (hand_m, "index_3")

        monkeypatch.setattr(f"{OUTCOME}.hand_distance", hand_distance)
        plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1.0) if support else None
        path = SimpleNamespace(
            centroid=CENTRE, at=lambda t_ns: T_rest if t_ns == CLOSE else np.full((4, 4), np.nan)
        )
        listed = tuple(sightings)
        return SimpleNamespace(support=plane, sightings=listed, path=path, n_registered=before)

    return made


LEFT = "the object is seen left on its support 2.2 s after the close"


@pytest.mark.parametrize(
    ("rise_m", "said"), [(0.0, True), (0.049, True), (0.0501, False), (-0.06, True)]
)
def test_an_object_left_on_its_support(seen: Seen, rise_m: float, said: bool) -> None:
    """Catches another line, and an object that fell lower than it stood."""
    found = outcome(trial(), seen([rise_m] * 3, 0.5))
    if not said:
        assert found == NOTHING_SAID
        return
    assert (found.outcome, found.source, found.evidence) == ("failure", "inferred", LEFT)
    assert found.p_success == pytest.approx(0.1)


@pytest.mark.parametrize(("hand_m", "said"), [(0.0399, False), (0.0401, True), (None, True)])
def test_an_object_low_in_the_hand_is_not_left_behind(
    seen: Seen, hand_m: float | None, said: bool
) -> None:
    """Catches a hand that did not rise taken for one that left the object."""
    assert outcome(trial(), seen([0.0] * 3, hand_m)).outcome == ("failure" if said else "unknown")


@pytest.mark.parametrize(("hand_m", "said"), [(0.0999, True), (0.1001, False), (None, True)])
def test_an_object_up_with_the_hand(seen: Seen, hand_m: float | None, said: bool) -> None:
    """Catches something else high up, away from the hand, taken for the object."""
    found = outcome(trial(), seen([0.18] * 3, hand_m))
    if not said:
        assert found == NOTHING_SAID
        return
    told = "the object is seen 18 cm up, 2.2 s after the close"
    assert found == Ended("success", "inferred", told, 0.9)


def test_how_high_it_is_follows_the_median(seen: Seen) -> None:
    """Catches a mean that one wrong sighting moves across the line."""
    found = outcome(trial(), seen([0.0, 0.0, 0.0, 0.0, 0.5], 0.5))
    assert found.outcome == "failure"


@pytest.mark.parametrize(
    ("rises", "said"),
    [
        ([0.0, 0.0, 0.3, 0.0, 0.3], True),  # two of five elsewhere
        ([0.0, 0.185, 0.19, 0.2, 0.21, 0.215, 0.4], True),  # half are within 15 mm of 0.20
        ([0.0, 0.175, 0.175, 0.2, 0.225, 0.225, 0.4], False),  # half are 25 mm off it
        ([0.0, 0.3, 0.1, 0.2, 0.4, 0.05], False),
    ],
)
def test_unsteady_heights_say_nothing(seen: Seen, rises: list[float], said: bool) -> None:
    """Catches something else in every frame believed, and a spread that outliers make."""
    hand_m = 0.05
    assert (outcome(trial(), seen(rises, hand_m)) != NOTHING_SAID) == said


@pytest.mark.parametrize(
    "given",
    [
        {"rises": [0.0] * 2},  # too few
        {
            "rises": [0.0] * 3,
            "first_s": 1.5,
        },  # two of them late enough: the lift has not ended at 1.5 s
        {"rises": [0.0] * 3, "by": "colour"},
        {"rises": [0.0] * 3, "by": "depth"},
        {"rises": [0.0] * 3, "support": False},
        {"rises": [0.0] * 3, "before": 4},  # registered before the close
    ],
)
def test_sightings_that_do_not_count(seen: Seen, given: dict[str, Any]) -> None:
    """Catches colour alone believed, sightings during the lift, heights over no support, and what
    was hardly seen before the close taken for the object after it.
    """
    assert outcome(trial(), seen(**given)) == NOTHING_SAID


def test_three_late_sightings_count(seen: Seen) -> None:
    """Catches `>=` and `>` mixed up in the number or the time."""
    assert outcome(trial(), seen([0.0] * 3, first_s=1.51)).outcome == "failure"
    assert outcome(trial(), seen([0.0] * 4, first_s=1.5)).outcome == "failure"


# both


UP = "the object is seen 18 cm up, 2.2 s after the close"


@pytest.mark.parametrize(
    ("joints", "rise_m", "hand_m", "expected"),
    [
        (GRIP, 0.18, 0.02, Ended("success", "inferred", f"{GRIP_SAYS} and {UP}", 0.99)),
        (EMPTY, 0.0, 0.5, Ended("failure", "inferred", f"{EMPTY_SAYS} and {LEFT}", 0.01)),
        (
            GRIP,
            0.0,
            0.02,
            Ended("success", "inferred", GRIP_SAYS, 0.97, True),
        ),  # unseen
        (GRIP, 0.0, 0.5, Ended("unknown", None, f"{GRIP_SAYS}, but {LEFT}")),
        (EMPTY, 0.18, 0.02, Ended("unknown", None, f"{EMPTY_SAYS}, but {UP}")),
    ],
)
def test_fingers_and_sightings_together(
    seen: Seen, joints: list[JointSample], rise_m: float, hand_m: float, expected: Ended
) -> None:
    """Catches a contradiction decided for one side, and confidence of one source where there are
    two.
    """
    found = outcome(trial(joints=joints), seen([rise_m] * 3, hand_m))
    assert found.p_success == pytest.approx(expected.p_success)
    assert replace(found, p_success=expected.p_success) == expected


@pytest.mark.parametrize(
    ("released_s", "expected"),
    [
        (3.0, ("success", f"{GRIP_SAYS}, before the hand opens again 3.0 s after the close")),
        (
            1.9,
            (
                "unknown",
                "the hand opens again 1.9 s after the close; an operator's word is: "
                f"{GIVE_A_LABEL}",
            ),
        ),
        (None, ("failure", EMPTY_SAYS)),
    ],
)
def test_what_the_hand_put_down_was_held(
    monkeypatch: pytest.MonkeyPatch, released_s: float | None, expected: tuple[str, str]
) -> None:
    """Fails where a pick and place is a failure, as nothing is held at the log's end."""
    released_ns = None if released_s is None else at(released_s)
    monkeypatch.setattr("dgeval.verdict.log.release_after", lambda *_: released_ns)
    held = efforts(0.30, -0.20, 0.0, 0.0, 0.0, last_s=3.0)
    opened = [replace(s, positions=dict.fromkeys(s.positions, 0.1)) for s in EMPTY]
    ended = outcome(trial(joints=[*held, *opened]), None)
    assert (ended.outcome, ended.evidence) == expected


def test_sightings_after_it_was_put_down_say_nothing(
    monkeypatch: pytest.MonkeyPatch, seen: Seen
) -> None:
    monkeypatch.setattr("dgeval.verdict.log.release_after", lambda *_: at(2.05))
    joints = efforts(0.0, 0.0, last_s=1.0)[:1]
    assert outcome(trial(joints=joints), seen([0.0] * 3)).outcome == "unknown"


@pytest.mark.parametrize(("ended", "speed"), [(True, 0.1), (False, 0.1), (False, 0.0)])
def test_a_log_that_ends_while_the_hand_comes_nearer_has_not_ended(
    ended: bool, speed: float
) -> None:
    """Fails where a recorder that stops before the close makes a failure of every success."""
    made = trial(closed=False, ended=ended, palm_speed=speed)
    found = outcome(made, near_to(0.05))
    cut = not ended and speed > 0
    assert found.outcome == ("unknown" if cut else "failure")
    assert ("no trial_end is marked" in found.evidence) == cut
    for after_s, told in ((0.2, "unknown"), (2.0, "failure")):  # images of another trial
        stamps = [START, at(4.0 + after_s)]
        made.scan.times["/colour"] = TopicTimes(stamps, stamps)
        if cut:
            assert outcome(made, near_to(0.05)).outcome == told


@pytest.mark.parametrize("values", [(1.0, 0.0), (0.0, 800.0)])
def test_a_gripper_that_is_told_to_open_lets_go(
    values: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where a thing that was put down on purpose was left on its support: fingers that are
    not recorded don't show that the hand opens. Those that are recorded say so themselves.
    """
    told = {"/gripper/command": list(zip((CLOSE, at(3.0)), values, strict=True))}
    log = log_of(trial(joints=jaws(0.0, 0.0), gripper=told))
    assert log.released_ns == at(3.0)
    with monkeypatch.context() as known:
        known.setattr("dgeval.verdict.log.fingers_seen", lambda *_: True)
        assert log_of(trial(joints=jaws(0.0, 0.0), gripper=told)).released_ns is None
    again = {"/gripper/command": [(CLOSE, 1.0), (at(2.0), 1.0), (at(3.0), 1.0)]}
    assert log_of(trial(joints=jaws(0.0, 0.0), gripper=again)).released_ns is None


def test_the_mean_of_noise_is_no_grip() -> None:
    """Fails where percent of a motor's current, with noise of 2, make a failure a success."""
    rng = np.random.default_rng(5)
    noisy = [
        replace(s, efforts={n: e + rng.normal(0, 2.0) for n, e in s.efforts.items()})
        for s in efforts(0.6, 0.6, 0.0, 0.0, 0.0, n=50)
    ]
    assert outcome(trial(joints=noisy), None).outcome == "failure"
    clear = [
        replace(s, efforts={n: e + rng.normal(0, 0.02) for n, e in s.efforts.items()})
        for s in efforts(0.3, 0.3, 0.0, 0.0, 0.0, n=50)
    ]
    assert outcome(trial(joints=clear), None).outcome == "success"
