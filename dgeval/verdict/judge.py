"""One trial's verdict: how it ended, the scene, the decision, blame, and the sentence.

The steps of the decision stand in `decide`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dgeval.config import VerdictConfig
from dgeval.failure_rule import Outcome, OutcomeSource, Unknown
from dgeval.hindsight.second_pass import Hindsight
from dgeval.robots.described_hand import ANY_FORCE_N, DescribedHand
from dgeval.verdict.decide import Blame, Decision, blame_of, undecided
from dgeval.verdict.draws import PRESSED_M, decide_scene
from dgeval.verdict.estimates import HandShown, hand_shown
from dgeval.verdict.evidence import Scene, scene_of
from dgeval.verdict.log import TrialLog
from dgeval.verdict.outcome import outcome_of, why_no_close
from dgeval.verdict.recorded_lift import LEAST_RISE_M
from dgeval.verdict.sentence import Times, sentence

LONG_UNSEEN_S = 0.5  # over which a place that was last seen then is no longer known to 2 or 3 mm
# a described hand's `closing_source` -> how it closes, for a person
CLOSING = {
    "recorded": "as it closed here",
    "estimates": "as in another trial",
    "set": "as set",
    "limits": "to its limits",
}


# of the speed, and m/s: two standard deviations beyond both are told; ours
DOUBTFUL_SHARE, DOUBTFUL_M_S = 0.1, 0.005
UNLIKE_THE_WHOLE = 0.5  # of the way that a speed makes; an object that got less far stood or turned
SAME_CLOSE_NS = 30_000_000  # ns; the twin's close times are so far apart


@dataclass(frozen=True, slots=True)
class VerdictRow:
    """The verdict's columns of the trial's row, by their names in `schema.TRIALS`."""

    outcome: Outcome
    outcome_source: OutcomeSource | None
    evidence: str
    failure_class: str | None = None
    p_imprecise_pose: float | None = None
    p_collision: float | None = None
    p_timing: float | None = None
    p_unknown: float | None = None
    sub_cause: str | None = None
    observed_class: str | None = None
    p_observed_imprecise_pose: float | None = None
    p_observed_collision: float | None = None
    p_observed_timing: float | None = None
    p_observed_unknown: float | None = None
    blame: str | None = None
    p_blame: float | None = None
    belief_source: str | None = None
    gap_s: float | None = None
    gap_sided: str | None = None
    speed_measured: float | None = None
    closing_source: str | None = None


@dataclass(frozen=True)
class Judgement:
    """The verdict as a row, and what the review draws: decisive moment ns, pushing link.

    shown: what the trial shows of its hand, for others. closes: moments of the close that were
    tried, ns, each with the share of draws in which the object is then held.
    """

    row: VerdictRow
    decisive_ns: int | None
    link: str | None
    notes: tuple[str, ...] = ()
    shown: HandShown | None = None
    closes: tuple[tuple[int, float], ...] = ()

    def holds_at(self, t_ns: int | None, close_ns: int | None) -> bool | None:
        """Whether a close at a time, ns, holds the object; None where that was not tried.

        close_ns: of the recorded one, which held it in a success.
        """
        if t_ns is None:
            return None
        if self.row.outcome == "success" and close_ns is not None:
            return True if abs(t_ns - close_ns) <= SAME_CLOSE_NS else None
        near = [share for at_ns, share in self.closes if abs(at_ns - t_ns) <= SAME_CLOSE_NS]
        return None if not near else max(near) >= 0.5


def judge(
    log: TrialLog, hindsight: Hindsight | None, config: VerdictConfig, seed: int
) -> Judgement:
    """The verdict on one trial from its recording alone.

    hindsight: None where the object was never tracked. seed: of the draws.
    """
    if log.motion_ns is not None:
        log = replace(log, close_missing=why_no_close(log, hindsight), motion_ns=None)
    ended = outcome_of(log, hindsight)
    close_ns = log.close_ns
    row = VerdictRow(ended.outcome, ended.source, ended.evidence)
    notes: list[str] = []
    if hindsight is not None:
        row = replace(row, gap_s=hindsight.gap_s, gap_sided=hindsight.gap_sided)
        # without a base frame it is the speed relative to the camera, of one sighting it is none
        if log.robot.base_frame is not None and hindsight.n_registered >= 2:
            speed = float((hindsight.path.velocity[-1] ** 2).sum() ** 0.5)
            row = replace(row, speed_measured=speed)
            notes += _doubtful_speed(hindsight, speed)
        notes += hindsight.notes
    if ended.outcome != "failure":
        shown = hand_shown(log, hindsight, ended, None)
        return Judgement(row, close_ns, None, tuple(notes), shown)
    answered = _decision(log, hindsight, config, seed)
    if isinstance(answered, Unknown) or hindsight is None:
        assert isinstance(answered, Unknown)
        evidence = f"{ended.evidence}; the cause is unknown: {answered.reason}"
        columns = class_columns(undecided(answered.reason, config.method))
        row = replace(row, evidence=evidence, **columns)
        shown = hand_shown(log, hindsight, ended, None)
        return Judgement(row, close_ns, None, tuple(notes), shown)
    scene, decision = answered
    pushed_ns = hindsight.pushed_ns or hindsight.contact_ns
    times = Times(log.first_ns, log.last_ns, close_ns, pushed_ns)
    link = pushing_link(decision, hindsight)
    blame = blame_of(decision, scene.beliefs)
    hand = scene.gripper
    row = replace(
        row,
        evidence=sentence(times, ended, decision, link) + _at_its_word(log, decision),
        blame="unknown" if isinstance(blame.part, Unknown) else blame.part,
        p_blame=None if isinstance(blame.part, Unknown) else blame.probability,
        belief_source=blame.source,
        closing_source=hand.closing_source if isinstance(hand, DescribedHand) else "known",
        **class_columns(decision),
    )
    notes += notes_of(scene, decision, blame)
    if log.untested and _is_of_pose(decision):
        notes.append(f"nothing in the log tests {'; nor '.join(log.untested)}")
    shown = hand_shown(log, hindsight, ended, scene)
    closes = closes_of(decision, times)
    return Judgement(row, decisive_ns(decision, times), link, tuple(notes), shown, closes)


def _is_of_pose(decision: Decision) -> bool:
    answer = decision.answer
    return not isinstance(answer, Unknown) and answer.failure_class == "imprecise_pose"


def _at_its_word(log: TrialLog, decision: Decision) -> str:
    """In words, that nothing ties the pictures to the robot, where a pose is what failed."""
    if len(log.untested) < 2 or not _is_of_pose(decision):
        return ""
    return ". Nothing in the log tests where its camera is: the whole cause hangs on it"


def _decision(
    log: TrialLog, hindsight: Hindsight | None, config: VerdictConfig, seed: int
) -> tuple[Scene, Decision] | Unknown:
    if log.close_ns is None and log.close_missing is not None:
        return Unknown(log.close_missing)
    if hindsight is None:
        return Unknown("the object was never tracked")
    scene = scene_of(log, hindsight)
    if isinstance(scene, Unknown):
        return scene
    decision = decide_scene(scene, config.method, config.draws, seed, config.least)
    return decision if isinstance(decision, Unknown) else (scene, decision)


def class_columns(decision: Decision) -> dict[str, Any]:
    """Both classes, sub-cause and probabilities of a decision, by column."""
    names = ("imprecise_pose", "collision", "timing", "unknown")
    both = (("p_", decision.probabilities), ("p_observed_", decision.observed))
    columns: dict[str, Any] = {
        f"{start}{name}": p for start, ps in both for name, p in zip(names, ps, strict=True)
    }
    seen = decision.observed_class
    columns["observed_class"] = "unknown" if isinstance(seen, Unknown) else seen
    known = not isinstance(decision.answer, Unknown)
    columns["failure_class"] = decision.answer.failure_class if known else "unknown"  # type: ignore[union-attr]
    columns["sub_cause"] = decision.answer.sub_cause if known else None  # type: ignore[union-attr]
    return columns


def pushing_link(decision: Decision, hindsight: Hindsight) -> str | None:
    """The link that moved the object in most of the draws' weight; the one that hindsight saw
    nearest counts as a draw of weight 1, as neighbouring fingers differ by a few millimetres.
    """
    votes = [(d.contact_link, d.weight) for d in decision.draws.asked if d.contact_link]
    votes += [(hindsight.contact_link, 1.0)] if hindsight.contact_link else []
    names = sorted({name for name, _ in votes})
    weight = {name: sum(w for link, w in votes if link == name) for name in names}
    return max(names, key=lambda name: weight[name]) if names else None


def notes_of(scene: Scene, decision: Decision, blame: Blame) -> list[str]:
    """What a verdict rests on, for the trial's notes."""
    notes = []
    if isinstance(blame.part, Unknown):
        notes.append(f"blame unknown: {blame.part.reason}")
    elif blame.part != "execution":
        sizes = ", ".join(f"{part} {size * 1000:.0f} mm" for part, size in blame.sizes.items())
        notes.append(f"blame: {sizes}")
        if not isinstance(scene.beliefs, Unknown) and scene.beliefs.gains is not None:
            level, upright = scene.beliefs.gains
            notes.append(
                f"commanded to the grasp with {level:.2f}/s level and {upright:.2f}/s upright"
            )
    hand = scene.gripper
    if isinstance(hand, DescribedHand):
        least, most = hand.force_n
        by = "" if hand.force_n == ANY_FORCE_N else ", by its efforts"
        closing = CLOSING[hand.closing_source]
        notes.append(
            f"verdict: the hand is {hand.told}; it closes {closing}, with {least:.0f} to "
            f"{most:.0f} N at a fingertip{by}"
        )
    unseen_s = scene.unseen_s(scene.reference)
    if scene.close is not None and unseen_s > LONG_UNSEEN_S:
        notes.append(
            f"verdict: the object was last seen undisturbed {unseen_s:.1f} s before the close; "
            f"where it would have been is known to {scene.sd_m * 1000:.0f} mm"
        )
    if scene.close is not None and scene.hand.finish is None:
        notes.append(
            "verdict: the lift is dgeval's own, straight up: after the close the log shows none of "
            f"{LEAST_RISE_M:.2f} m or more that has come to rest before the log ends"
        )
    if scene.held:
        notes.append(
            "verdict: someone holds the object; it is assumed to be let go once two fingers press "
            "it for 0.1 s, and how it gives way before is not modelled (of 9 simulated answers of "
            "this kind 6 were right: take it as a hint)"
        )
    draws = decision.draws
    if draws.softened:
        notes.append(
            f"verdict: {draws.softened} times a draw pressed the hand more than "
            f"{PRESSED_M * 1000:.0f} mm into the object and was made again with half of the force"
        )
    notes.append(
        f"verdict: {draws.instrument}, {len(draws.asked)} draws, "
        f"{draws.share_reproduced:.0%} reproduce the failure"
    )
    return notes


def _doubtful_speed(hindsight: Hindsight, speed: float) -> list[str]:
    """Notes where the undisturbed object was seen too briefly to know its speed, m/s, or where the
    speed at the end is not that of the whole way.
    """
    path = hindsight.path
    lasted_s = (int(path.t_ns[-1]) - int(path.t_ns[0])) * 1e-9
    notes = []
    if 2 * path.sd_velocity > max(DOUBTFUL_SHARE * speed, DOUBTFUL_M_S):
        notes.append(
            f"speed_measured, {speed:.3f} m/s, is known to ± {2 * path.sd_velocity:.3f} m/s alone: "
            f"the undisturbed object was seen {len(path.t_ns)} times in {lasted_s:.1f} s"
        )
    way = float(np.linalg.norm(path.position[-1] - path.position[0]))
    if speed > DOUBTFUL_M_S and way < UNLIKE_THE_WHOLE * speed * lasted_s:
        notes.append(
            f"speed_measured, {speed:.3f} m/s, is that at the end: from its first to its last "
            f"undisturbed sighting, in {lasted_s:.1f} s, the object got {way:.3f} m far, "
            f"{way / lasted_s:.3f} m/s"
        )
    return notes


def closes_of(decision: Decision, times: Times) -> tuple[tuple[int, float], ...]:
    """The close times that were tried, ns, each with the share of draws that then hold."""
    held: dict[float, list[bool]] = {}
    for draw in decision.draws.asked:
        for offset_s, holds in draw.facts.curve:
            held.setdefault(offset_s, []).append(holds)
    return tuple((times.shifted_ns(s), sum(h) / len(h)) for s, h in sorted(held.items()))


def decisive_ns(decision: Decision, times: Times) -> int | None:
    """When it was decided: the push, the close, or the good moment of a hand that never closed."""
    answer = decision.answer
    if isinstance(answer, Unknown):
        return times.close_ns
    if answer.failure_class == "collision":
        return times.pushed_ns or times.close_ns
    if answer.failure_class == "timing" and answer.shift_s is not None and times.close_ns is None:
        return times.shifted_ns(answer.shift_s)
    return times.close_ns
