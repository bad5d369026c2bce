"""One trial's verdict: outcome, class, sub-cause, blame, and the sentence a person would say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dgeval.config import Config
from dgeval.hindsight.second_pass import Hindsight
from dgeval.recording.trials import Trial
from dgeval.verdict.blame import blame_of
from dgeval.verdict.decide import Cause, cause_of
from dgeval.verdict.evidence import Scene, scene_of
from dgeval.verdict.outcome import outcome_of
from dgeval.verdict.sentence import sentence

VERDICT_COLUMNS = (
    "failure_class", "p_imprecise_pose", "p_collision", "p_timing", "p_unknown", "sub_cause", "blame", "p_blame",
    "belief_source", "gap_s", "gap_sided", "speed_measured",
)  # fmt: skip


@dataclass(frozen=True)
class Judgement:
    """Columns of the trial's row, and what the review draws: the decisive moment ns, the offending link."""

    columns: dict[str, Any]
    decisive_ns: int | None
    link: str | None
    notes: tuple[str, ...] = ()


def judge(trial: Trial, hindsight: Hindsight | None, config: Config) -> Judgement:
    """The verdict on one trial from its recording alone."""
    ended = outcome_of(trial, hindsight)
    close_ns = trial.event_ns("close")
    columns: dict[str, Any] = dict.fromkeys(VERDICT_COLUMNS)
    columns.update(outcome=ended.outcome, outcome_source=ended.source, evidence=ended.evidence)
    notes: list[str] = []
    if hindsight is not None:
        columns["gap_s"], columns["gap_sided"] = hindsight.gap_s, hindsight.gap_sided
        speed = float((hindsight.path.velocity[-1] ** 2).sum() ** 0.5)
        columns["speed_measured"] = speed
        notes += hindsight.notes
    if ended.outcome != "failure":
        return Judgement(columns, close_ns, None, tuple(notes))
    cause: Cause | str
    scene: Scene | str = "the object was never tracked"
    if hindsight is None:
        cause = str(scene)
    else:
        scene = scene_of(trial, hindsight)
        v = config.verdict
        try:
            cause = (
                scene
                if isinstance(scene, str)
                else cause_of(scene, v.method, v.draws, config.seed, v.least)
            )
        except (
            ValueError
        ) as error:  # a cloud that spans no volume, or that MuJoCo can't make a solid of
            cause = str(error)
    if isinstance(cause, str) or isinstance(scene, str) or hindsight is None:
        columns.update(
            failure_class="unknown",
            p_imprecise_pose=0.0,
            p_collision=0.0,
            p_timing=0.0,
            p_unknown=1.0,
        )
        columns["evidence"] = f"{ended.evidence}; the cause is unknown: {cause}"
        return Judgement(columns, close_ns, None, tuple(notes))
    names = ("p_imprecise_pose", "p_collision", "p_timing", "p_unknown")
    columns.update(zip(names, cause.probabilities, strict=True))
    columns["failure_class"] = cause.failure_class
    columns["sub_cause"] = cause.sub_cause
    links = [s.contact_link for s in cause.samples if s.contact_link]
    link = max(sorted(set(links)), key=links.count) if links else hindsight.contact_link
    blame = blame_of(cause, scene.beliefs)
    columns["blame"], columns["belief_source"] = blame.term, blame.source
    columns["p_blame"] = blame.probability if blame.term != "unknown" else None
    columns["evidence"] = sentence(trial, hindsight, ended, cause, link)
    if blame.term == "unknown":
        notes.append(f"blame unknown: {blame.why_unknown}")
    elif blame.term != "execution":
        notes.append(
            "blame: " + ", ".join(f"{k} {v * 1000:.0f} mm" for k, v in blame.sizes.items())
        )
        if not isinstance(scene.beliefs, str) and scene.beliefs.gains is not None:
            notes.append(
                "commanded to the grasp with {:.2f}/s level and {:.2f}/s upright".format(
                    *scene.beliefs.gains
                )
            )
    if scene.held:
        notes.append(
            "verdict: someone holds the object; it is assumed to be let go once two fingers press it for 0.1 s"
        )
    notes.append(
        f"verdict: {cause.instrument}, {len(cause.samples)} draws, {cause.reproduced:.0%} reproduce the failure"
    )
    decisive = close_ns
    if cause.failure_class == "collision":
        decisive = hindsight.pushed_ns or hindsight.contact_ns or close_ns
    elif cause.failure_class == "timing" and cause.shift_s is not None and close_ns is None:
        decisive = trial.pairs[-1][0] + round(cause.shift_s * 1e9)
    return Judgement(columns, decisive, link, tuple(notes))
