"""How a trial ended: an operator's label, else what hand and object show after the lift.

Where neither tells, the outcome is unknown with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.failure_rule import (
    NEAR_M,
    Outcome,
    OutcomeSource,
    Unknown,
    outcome_without_close,
)
from dgeval.geometry import Array, transform
from dgeval.hindsight.moments import hand_distance
from dgeval.hindsight.second_pass import Hindsight
from dgeval.recording.contract import GIVE_A_LABEL
from dgeval.recording.messages import JointSample
from dgeval.recording.robot import RobotStates
from dgeval.robots.described_hand import DescribedHand
from dgeval.robots.hand import Grip, Hand, hands
from dgeval.verdict.described_grip import described_grip, rest_of_closed
from dgeval.verdict.evidence import MIN_REGISTERED
from dgeval.verdict.log import TrialLog

AFTER_S = 1.0  # s after the close, from which fingers at rest tell what they hold; ours
# s, likewise of a hand that opens again: what is gripped, lifted and put down takes longer than
# fingers that lean on something and spring back; ours
RELEASED_S = 2.0
# fingers of which equal efforts are no chance; ns after the close, when fingers have met what they
# grip; rad, by which fingers that a brake holds move at most; ours
LEAST_ALIKE = 3
BRAKED_NS, STAYS_RAD = 500_000_000, 0.03
FALLS_NS = 300_000_000  # ns, after the last time they press, in which fingers close further; ours
POSE_STEP_NS = 50_000_000  # ns, between the times at which the palm is asked for
MOST_LOOKS = 400  # times at which the hand's distance to the object is asked for; ours
MOVED_M = 0.01  # m, by which a hand that stood still seems to move at most; ours
LAST_S = 0.5  # s of the log, over which efforts are judged; ours
# m, object's middle to hand: within a large hand's fingers, and out of their reach; ours
IN_HAND_M, AWAY_M = 0.04, 0.10
# probability that an inferred outcome is right: by fingers and sightings, fingers, sightings; ours
P_BOTH, P_FINGERS, P_SEEN = 0.99, 0.97, 0.90
LEAST_AFTER = 20  # joint states after the close, that tell whether the fingers moved
# m; half of the sightings after the lift agree on the height to within that, or say nothing
STEADY_M = 0.02
# m: rise below which a sighted object was left, above which it came along
LEFT_BEHIND_M, CARRIED_M = 0.05, 0.05


@dataclass(frozen=True, slots=True)
class Ended:
    """Outcome with its source and, in words, why; `p_success` where it was inferred. by_fingers:
    nothing else tells it.
    """

    outcome: Outcome
    source: OutcomeSource | None
    evidence: str
    p_success: float | None = None
    by_fingers: bool = False


def outcome_of(log: TrialLog, hindsight: Hindsight | None) -> Ended:
    """The outcome of a trial, by the first of these that tells.

    A label; no close: how near the hand came; a log that ends with the close: unknown; then fingers
    and sightings.
    """
    shown = _shown(log, hindsight)
    if log.label not in ("success", "failure"):
        return shown
    said = "an operator's label says so"
    if shown.source == "inferred" and shown.outcome != log.label:
        said += f", though {shown.evidence}"
    return Ended("success" if log.label == "success" else "failure", "label", said)


def _shown(log: TrialLog, hindsight: Hindsight | None) -> Ended:
    """What hand and object show, without an operator's word."""
    close_ns = log.close_ns
    if close_ns is None:
        if log.damaged:
            return Ended(
                "incomplete",
                None,
                "a part of the recording is damaged or missing, and what can be read has no close",
            )
        if (why := why_no_close(log, hindsight)) is not None:
            return Ended("unknown", None, why)
        return _without_close(log, hindsight)
    last_ns = _last_ns(log)
    after_s = max(0.0, (last_ns - close_ns) * 1e-9)
    if after_s < (AFTER_S if log.released_ns is None else RELEASED_S):
        if log.released_ns is None:
            return Ended("unknown", None, f"the log ends {after_s:.1f} s after the close")
        what = f"the hand opens again {after_s:.1f} s after the close"
        return Ended("unknown", None, f"{what}; an operator's word is: {GIVE_A_LABEL}")
    fingers = _pressing(log, last_ns)
    if isinstance(fingers, Unknown):
        return Ended("unknown", None, fingers.reason)
    seen = _seen_after(log.robot, hindsight, close_ns, log.released_ns)
    if fingers is None and seen is None:
        why = "neither efforts nor a sighting after the lift say how it ended"
        why += _untold(log, last_ns)
        if _is_stuck(log):
            why += " (the fingers' states stay the same from the close on: does their driver hang?)"
        efforts = [e for s in log.hand_samples for e in s.efforts.values()]
        if efforts and not any(efforts):
            why += " (all efforts are 0, as where they are not measured)"
        return Ended("unknown", None, f"{why}; an operator's word does: {GIVE_A_LABEL}")
    if fingers is not None and seen is not None and fingers[0] != seen[0]:
        return Ended("unknown", None, f"{fingers[1]}, but {seen[1]}")
    held = (fingers or seen)[0]  # type: ignore[index]
    reasons = " and ".join(s[1] for s in (fingers, seen) if s is not None)
    if log.released_ns is not None:
        reasons += f", before the hand opens again {after_s:.1f} s after the close"
    confident = (
        P_BOTH
        if fingers is not None and seen is not None
        else P_FINGERS
        if fingers is not None
        else P_SEEN
    )
    return Ended(
        "success" if held else "failure",
        "inferred",
        reasons,
        confident if held else 1 - confident,
        seen is None,
    )


def why_no_close(log: TrialLog, hindsight: Hindsight | None) -> str | None:
    """In words, why no close is known of a log without one; None where the hand never closed.

    Fingers that moved for the last time before the hand had come near the object took a shape for
    the grasp.
    """
    if log.close_missing is None or log.motion_ns is None or hindsight is None:
        return log.close_missing
    step = max(POSE_STEP_NS, (log.motion_ns - log.first_ns) // MOST_LOOKS)
    for t_ns in range(log.first_ns, log.motion_ns + 1, step):
        placed = transform(hindsight.path.at(t_ns), hindsight.points)
        near = hand_distance(log.robot, t_ns, placed)
        if near is None or near[0] < NEAR_M:
            return log.close_missing
    return None


def _last_ns(log: TrialLog) -> int:
    """When the trial ends, by its images and its joint states, or the hand opens again."""
    end_ns = max(log.last_ns, log.limit_ns or 0)
    joints = [s.t_ns for s in log.hand_samples if s.t_ns <= end_ns]
    ends_ns = max([log.last_ns, *joints[-1:]])
    return ends_ns if log.released_ns is None else min(ends_ns, log.released_ns)


def empty_fingers(log: TrialLog, hand: DescribedHand, ended: Ended) -> Array | None:
    """(k,) rad or m, where the joints rest at the end of a trial that failed by an operator's word
    or a sighting; None where neither says so, or they don't rest closed.
    """
    if ended.outcome != "failure" or ended.by_fingers or log.close_ns is None or _is_stuck(log):
        return None
    last_ns = _last_ns(log)
    end = _at_the_end(log, last_ns)
    return rest_of_closed(hand, list(log.hand_samples), log.close_ns, end)


def _at_the_end(log: TrialLog, last_ns: int) -> list[JointSample]:
    first_ns = last_ns - round(LAST_S * 1e9)
    return [s for s in log.hand_samples if first_ns <= s.t_ns <= last_ns]


def _without_close(log: TrialLog, hindsight: Hindsight | None) -> Ended:
    """The outcome where the hand is known never to have closed."""
    times = range(log.first_ns, log.last_ns + 1, POSE_STEP_NS)
    palms = [T[:3, 3] for t in times if (T := log.robot.T_base_palm(t)) is not None]
    moved = not palms or float(np.ptp(palms, axis=0).max()) > MOVED_M
    nearest = None if hindsight is None else hindsight.nearest_m
    outcome, why = outcome_without_close(len(palms) / len(times), nearest, moved)
    if outcome != "unknown" and log.is_cut:
        why += (
            ", but the log ends while it moves and no trial_end is marked: what came then is not "
        )
        return Ended("unknown", None, f"{why}known; an operator's word is: {GIVE_A_LABEL}")
    if outcome == "unknown":
        return Ended(outcome, None, why)
    if outcome == "failure" and (doubt := _doubt_without_close(log, hindsight)):
        return Ended("unknown", None, doubt)
    return Ended(outcome, "inferred", why, 0.0 if outcome == "failure" else None)


def _doubt_without_close(log: TrialLog, hindsight: Hindsight | None) -> str:
    """In words, why fingers that never closed may have, with what tells; "" where nothing says so.

    A log that begins with the hand at the object may begin after the close. A palm that comes near
    and rises again has gripped, or given up: fingers whose states never change tell neither.
    """
    if hindsight is not None:
        placed = transform(hindsight.path.at(log.first_ns), hindsight.points)
        near = hand_distance(log.robot, log.first_ns, placed)
        if near is not None and near[0] < NEAR_M:
            return (
                "the hand is at the object from the first frame on and does not close: does the "
                "log begin after the close? Record the approach, or an operator's word is: "
                f"{GIVE_A_LABEL}"
            )
    times = range(log.first_ns, log.last_ns + 1, POSE_STEP_NS)
    heights = [(float(T[2, 3]), t) for t in times if (T := log.robot.T_base_palm(t)) is not None]
    lowest, low_ns = min(heights, default=(0.0, 0))
    rose = max((z for z, t in heights if t >= low_ns), default=lowest) - lowest > CARRIED_M
    if not rose:
        return ""
    if _same_throughout(log):
        return (
            "the hand came to the object and rose, and the states of its fingers are the same to "
            "the last digit throughout: does their driver hang? If it closed: --close TIME; if "
            "not: --label failure"
        )
    return _doubt_by_object(log, hindsight, low_ns)


def _doubt_by_object(log: TrialLog, hindsight: Hindsight | None, low_ns: int) -> str:
    """The doubt where a hand that seems never to have closed rose from the object, at low_ns: a
    grip on a thing as wide as the open hand hardly moves its fingers. "" where the object is seen
    left behind.
    """
    if hindsight is None:
        return ""
    placed = transform(hindsight.path.at(low_ns), hindsight.points)
    near = hand_distance(log.robot, low_ns, placed)
    if near is None or near[0] >= NEAR_M:
        return ""
    seen = _seen_after(log.robot, hindsight, low_ns)
    if seen is not None and not seen[0]:
        return ""
    what = "nothing shows whether it took it along" if seen is None else seen[1]
    return (
        "the hand rose from the object, its fingers seem never to have closed, and "
        f"{what}: if it closed: --close TIME; if not: --label failure"
    )


def _same_throughout(log: TrialLog) -> bool:
    """Whether positions and efforts of all finger joints stay the same, to the last digit."""
    hand = _hand_of(log)
    if hand is None or len(log.hand_samples) < LEAST_AFTER:
        return False
    first = log.hand_samples[0]
    return all(
        s.positions.get(n) == first.positions.get(n) and s.efforts.get(n) == first.efforts.get(n)
        for s in log.hand_samples
        for n in hand.joints
    )


def _pressing(log: TrialLog, last_ns: int) -> tuple[bool, str] | Unknown | None:
    """What the fingers say at the end; None without signals, `Unknown` where they contradict each
    other.

    Names of joints tell the hand only where no description says more.
    """
    samples = _at_the_end(log, last_ns)
    if _is_stuck(log):
        return None
    described = log.robot.description is not None
    shown = None
    if described:
        geometry = log.robot.hand_by_description
        if isinstance(geometry, DescribedHand) and log.close_ns is not None:
            empty = log.elsewhere.empty
            shown = described_grip(geometry, list(log.hand_samples), log.close_ns, samples, empty)
        if isinstance(log.robot.hand, DescribedHand):
            return shown
    for grip in _known_grips(log):
        if grip.signal == "effort" and (peak := _peak(log, grip)) > grip.most:
            return Unknown(
                f"the fingers' efforts reach {peak:.0f}, more than this hand's {grip.most:.0f} Nm: "
                "are they in other units?"
            )
        values = [s.positions if grip.signal == "position" else s.efforts for s in samples]
        rows = [[v[n] for n in grip.joints] for v in values if all(n in v for n in grip.joints)]
        if len(rows) >= grip.least:
            holds = grip.holds(np.array(rows))
            if grip.signal == "effort" and (
                _is_commanded(rows) if holds[0] else _falls_away(log, grip, last_ns)
            ):
                continue
            if shown is not None and shown[0] != holds[0]:
                return Unknown(
                    f"{holds[1]}, but {shown[1]}: are efforts in other units, or is their zero off?"
                )
            return holds
    return None


def _untold(log: TrialLog, last_ns: int) -> str:
    """In words, why the efforts of a known hand tell nothing at the end; "" for no such reason."""
    grips = [grip for grip in _known_grips(log) if grip.signal == "effort"]
    for grip in grips:
        rows = _efforts(grip, _at_the_end(log, last_ns))
        if _is_commanded(rows) and grip.holds(np.array(rows))[0]:
            return (
                " (the efforts of all fingers are one number to the last digit, as commanded ones)"
            )
        if _falls_away(log, grip, last_ns):
            return " (the efforts fall away while the fingers stay where they are, as with a brake)"
    return ""


def _known_grips(log: TrialLog) -> list[Grip]:
    """How a grip shows of the hand that dgeval knows; of all of them without a description."""
    known: tuple[Hand | DescribedHand | None, ...] = hands()
    if log.robot.description is not None:
        known = (log.robot.hand,)
    grips = [hand.grip for hand in known if isinstance(hand, Hand)]
    return [grip for grip in grips if grip is not None and _is_signal(log, grip)]


def _efforts(grip: Grip, samples: list[JointSample]) -> list[list[float]]:
    """Rows of the efforts of a grip's joints, of the samples that have them all."""
    return [
        [s.efforts[n] for n in grip.joints]
        for s in samples
        if all(n in s.efforts for n in grip.joints)
    ]


def _is_commanded(rows: list[list[float]]) -> bool:
    """Whether the efforts of three joints or more are one number that never changes: no measured
    ones are.
    """
    values = {v for row in rows for v in row}
    return bool(rows) and len(rows[0]) >= LEAST_ALIKE and len(values) == 1 and values != {0.0}


def _falls_away(log: TrialLog, grip: Grip, last_ns: int) -> bool:
    """Whether fingers pressed after the close, press no more at the end, and stay where they were:
    what slips away lets fingers close further, a brake that holds them does not.
    """
    assert log.close_ns is not None
    samples = [
        s
        for s in log.hand_samples
        if log.close_ns + BRAKED_NS <= s.t_ns <= last_ns
        and all(n in s.efforts and n in s.positions for n in grip.joints)
    ]
    end = _efforts(grip, _at_the_end(log, last_ns))
    if len(end) < grip.least or grip.holds(np.array(end))[0]:
        return False
    step = max(grip.least, 1)
    for k in range(0, len(samples) - step, step)[::-1]:
        if grip.holds(np.array(_efforts(grip, samples[k : k + step])))[0]:
            until_ns = samples[k].t_ns + FALLS_NS
            falling = [s for s in samples[k:] if s.t_ns <= until_ns]
            q = np.array([[s.positions[n] for n in grip.joints] for s in falling])
            is_seen = falling[-1].t_ns > until_ns - FALLS_NS // 2
            return is_seen and bool(np.ptp(q, axis=0).max() < STAYS_RAD)
    return False


def _hand_of(log: TrialLog) -> Hand | DescribedHand | None:
    """The hand by its description; None without one, where names of joints tell no hand."""
    return log.robot.hand if log.robot.description is not None else None


def _is_stuck(log: TrialLog) -> bool:
    """Whether all finger joints stay the same from the close on, to the last digit: their driver
    hangs, or the hand did not move.
    """
    hand, close_ns = _hand_of(log), log.close_ns
    if hand is None or close_ns is None:
        return False
    before = [s for s in log.hand_samples if s.t_ns <= close_ns]
    after = [s for s in log.hand_samples if s.t_ns > close_ns]
    seen = [n for n in hand.joints if before and n in before[-1].positions]
    if not seen or len(after) < LEAST_AFTER:
        return False
    return all(s.positions.get(n) == before[-1].positions[n] for s in after for n in seen)


def _is_signal(log: TrialLog, grip: Grip) -> bool:
    """Whether a grip's signal can tell anything: efforts that are always 0 are not measured."""
    if grip.signal == "position":
        return True
    return any(s.efforts.get(name) for s in log.hand_samples for name in grip.joints)


def _peak(log: TrialLog, grip: Grip) -> float:
    """The effort that a hundredth of the samples of a grip's joints passes; 0 without any."""
    efforts = [abs(s.efforts[n]) for s in log.hand_samples for n in grip.joints if n in s.efforts]
    return float(np.percentile(efforts, 99)) if efforts else 0.0


def _seen_after(
    robot: RobotStates, hindsight: Hindsight | None, close_ns: int, released_ns: int | None = None
) -> tuple[bool, str] | None:
    """What registered sightings late in the log, and before the hand opens again, show: left on the
    support, or up with the hand.
    """
    if hindsight is None or hindsight.support is None:
        return None
    if hindsight.n_registered < MIN_REGISTERED:
        return None  # what was hardly seen before may be another thing after
    later = [
        s
        for s in hindsight.sightings
        if s.t_ns > close_ns + 1_500_000_000
        and (released_ns is None or s.t_ns < released_ns)
        and s.by == "registration"
    ]
    if len(later) < 3:
        return None
    centre = hindsight.path.centroid
    rest = float(
        hindsight.support.height((hindsight.path.at(close_ns) @ np.append(centre, 1.0))[:3])
    )
    rises = [
        float(hindsight.support.height((s.T_base_model @ np.append(centre, 1.0))[:3])) - rest
        for s in later
    ]
    rise = float(np.median(rises))
    if float(np.median(np.abs(np.subtract(rises, rise)))) > STEADY_M:
        return None  # taken for something else from frame to frame
    at = (later[-1].t_ns - close_ns) * 1e-9
    near = hand_distance(robot, later[-1].t_ns, transform(later[-1].T_base_model, centre[None]))
    if rise < LEFT_BEHIND_M:
        if near is not None and near[0] < IN_HAND_M:
            return None
        return False, f"the object is seen left on its support {at:.1f} s after the close"
    # high up and away from the hand it is something else, or in another person's hand
    if rise > CARRIED_M and (near is None or near[0] < AWAY_M):
        return True, f"the object is seen {rise * 100:.0f} cm up, {at:.1f} s after the close"
    return None
