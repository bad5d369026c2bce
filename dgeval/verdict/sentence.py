"""The sentence that a person would say about a failed trial."""

from __future__ import annotations

from dgeval.hindsight.second_pass import Hindsight
from dgeval.recording.trials import Trial
from dgeval.verdict.decide import Cause
from dgeval.verdict.outcome import Ended

WORDS = {"imprecise_pose": "imprecise pose", "collision": "collision", "timing": "timing"}


def sentence(
    trial: Trial, hindsight: Hindsight, ended: Ended, cause: Cause, link: str | None
) -> str:
    """What a person would say, with times in seconds from the trial's first frame."""
    start = trial.pairs[0][0]
    close_ns = trial.event_ns("close")

    def at(t_ns: int) -> str:
        return f"{(t_ns - start) * 1e-9:.2f} s"

    closed = (
        f"the hand closed at {at(close_ns)}" if close_ns is not None else "the hand never closed"
    )
    if cause.failure_class == "unknown":
        return f"{closed}, {ended.evidence}; the cause is unknown: {cause.why_unknown}"
    p = max(cause.probabilities)
    facts = next(s.facts for s in cause.samples if s.verdict.failure_class == cause.failure_class)
    said = f"{closed}, {ended.evidence}: {WORDS[cause.failure_class]} ({p:.0%}). "
    if cause.failure_class == "collision":
        when = hindsight.pushed_ns or hindsight.contact_ns
        who = f"{link} " if link else "the hand "
        where = f" at {at(when)}" if when is not None else ""
        off = f"{facts.displacement_m * 1000:.0f} mm and {facts.displacement_deg:.0f} degrees"
        return f"{said}{who}pushed the object{where}; it was {off} off its path by the close, and on its path it could be lifted"
    if cause.failure_class == "timing":
        shift = cause.shift_s or 0.0
        if close_ns is None:
            good = trial.pairs[-1][0] + round(shift * 1e9)
            return said + f"Closing at {at(good)} would have lifted the object"
        late = "earlier" if shift < 0 else "later"
        good = close_ns + round(shift * 1e9)
        return f"{said}The same approach closed {abs(shift):.2f} s {late}, at {at(good)}, lifts the object"
    if not facts.curve:
        return said + "The hand was never near the object"
    pushed = (
        f", not even without the push of {facts.displacement_m * 1000:.0f} mm"
        if facts.displacement_m > 0.005
        else ""
    )
    how = "was not in the grasp" if cause.sub_cause == "missed" else "was lifted and slipped"
    return f"{said}The object {how}; no close from {facts.curve[0][0]:+.1f} s to {facts.curve[-1][0]:+.1f} s lifts it{pushed}"
