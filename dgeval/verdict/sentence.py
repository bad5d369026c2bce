"""The sentence that a person would say about a failed trial: a row of `SUB_CAUSES`, filled in."""

from __future__ import annotations

from dataclasses import dataclass

from dgeval.failure_rule import Unknown, sub_cause_named
from dgeval.verdict.decide import RARELY, Decision
from dgeval.verdict.outcome import Ended

CLASS_TEXT = {"imprecise_pose": "imprecise pose", "collision": "collision", "timing": "timing"}
# m; a push beyond this is mentioned though it did not decide (the rule's 5 mm)
PUSHED_TOO_M = 0.005


@dataclass(frozen=True, slots=True)
class Times:
    """Moments of a trial, ns: first and last frame; close and push, None where there was none."""

    first_ns: int
    last_ns: int
    close_ns: int | None
    pushed_ns: int | None

    def text(self, t_ns: int) -> str:
        """A moment in seconds from the first frame."""
        return f"{(t_ns - self.first_ns) * 1e-9:.2f} s"

    def shifted_ns(self, shift_s: float) -> int:
        """A shift from the close, or from the last frame if it never came, as a moment."""
        return (self.last_ns if self.close_ns is None else self.close_ns) + round(shift_s * 1e9)


def sentence(times: Times, ended: Ended, decision: Decision, link: str | None) -> str:
    """What happened, with times in seconds from the trial's first frame."""
    if times.close_ns is not None:
        ending = f"the hand closed at {times.text(times.close_ns)}, {ended.evidence}"
    elif ended.source == "inferred":
        ending = ended.evidence  # says so itself
    else:
        ending = f"the hand never closed, {ended.evidence}"
    answer = decision.answer
    if isinstance(answer, Unknown):
        return f"{ending}; the cause is unknown: {answer.reason}"
    begin = f"{ending}: {CLASS_TEXT[answer.failure_class]} "
    begin += f"({max(decision.probabilities):.0%}). "
    row = sub_cause_named(answer.sub_cause)
    if answer.failure_class == "imprecise_pose" and not decision.chosen[0].facts.curve:
        return begin + "The hand was never near the object"
    return (
        begin + row.sentence.format(**fields_of(times, decision, link)) + _rarely(ended, decision)
    )


def _rarely(ended: Ended, decision: Decision) -> str:
    """In words, that few draws fail as the log does; empty where many do."""
    share = decision.draws.share_reproduced
    if share >= RARELY:
        return ""
    doubt = "doubt this cause" + ("" if ended.source == "inferred" else ", or the label")
    return f". In the physics only {share:.0%} of the draws fail as the trial did: {doubt}"


def fields_of(times: Times, decision: Decision, link: str | None) -> dict[str, str | float]:
    """What a sub-cause's sentence may name.

    link, pushed_at (" at 1.23 s" or empty), off_mm, off_deg: off the undisturbed path before the
    close. shift_s, direction, good_at: how much earlier or later a close would have worked, and
    when. first_s, last_s: range of the closes that were tried. pushed_too: a push that did not
    decide.
    """
    assert not isinstance(decision.answer, Unknown)
    facts = decision.chosen[0].facts
    shift = decision.answer.shift_s or 0.0
    out: dict[str, str | float] = {
        "link": link or "the hand",
        "pushed_at": "" if times.pushed_ns is None else f" at {times.text(times.pushed_ns)}",
        "off_mm": facts.displacement_m * 1000,
        "off_deg": facts.displacement_deg,
        "shift_s": abs(shift),
        "direction": "earlier" if shift < 0 else "later",
        "good_at": times.text(times.shifted_ns(shift)),
        "pushed_too": "",
    }
    if facts.curve:
        out.update(first_s=facts.curve[0][0], last_s=facts.curve[-1][0])
    if facts.displacement_m > PUSHED_TOO_M:
        millimetres = facts.displacement_m * 1000
        out["pushed_too"] = f", not even without the push of {millimetres:.0f} mm"
    return out
