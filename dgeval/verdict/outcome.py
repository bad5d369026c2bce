"""The outcome of a trial as far as the log states it. Inferring it needs the hindsight pass, which is not built yet."""

from __future__ import annotations

from dataclasses import dataclass

from dgeval.taxonomy import FailureClass, Outcome, OutcomeSource


@dataclass(frozen=True, slots=True)
class StatedOutcome:
    outcome: Outcome
    source: OutcomeSource | None
    failure_class: FailureClass | None
    evidence: str


def stated_outcome(label: str | None, t_close_ns: int | None, damaged: bool) -> StatedOutcome:
    """An operator's label wins; without a close command there was no grasp; the rest is unknown, with the reason."""
    if label in ("success", "failure"):
        failed = label == "failure"
        why = "an operator's label says so"
        if failed:
            why += "; the cause is unknown: this version has no hindsight pass"
        return StatedOutcome("failure" if failed else "success", "label", "unknown" if failed else None, why)
    if damaged and t_close_ns is None:
        return StatedOutcome("incomplete", None, None, "the recording is damaged and what can be read of it has no close")
    if t_close_ns is None:
        return StatedOutcome("no_grasp", "inferred", None, "the log has no close command")
    return StatedOutcome("unknown", None, None, "the hand closes, but no label says how it ended, and nothing infers it yet")
