"""From what the draws say to the answer, in the order of its steps.

A draw is one sample of what is uncertain (place, turn, friction, mass). `draws.draws_of` makes
them; here nothing is simulated.

1. The object's place at the close must be known (`too_uncertain`, `gave_way`).
2. The failure rule gives each draw a class (`failure_rule.classify`).
3. The draws vote, each by its weight (`vote`).
4. Three doubts, in this order, make the answer unknown (`doubt_of`).
5. Sub-cause and shift come from the draws of the winning class (`lead_of`).
6. Blame: the first of eleven cases that holds (`blame_of`; three for a hand that never closed).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dgeval.failure_rule import CLASSES, Facts, FailureClass, Unknown, Verdict
from dgeval.geometry import Array
from dgeval.verdict.beliefs import Beliefs

# Development trials are those of `python -m benchmarks.verdict --seed 2000` (scenario failures),
# `--scenario handover --seed 77`, and the 120 rendered ones of `dgeval simulate conveyor`.
# m, standard deviation of the object's place beyond which step 1 stops; ours
BLIND_SD_M = 0.025
# s, since what someone holds was last seen undisturbed: how it gives way to a hand is not modelled.
# Of 19 handovers (seed 0) that never closed 11 were answered rightly, where 91 % were stated; ours
HELD_UNSEEN_S = 2.0
# draws, added to each class: three draws that agree are right in 9 of 10 development trials
PRIOR = 0.15
# share of draws that fail as recorded, below which no instrument is believed; development trials
TRUSTED = 0.05
# likewise for a collision: a displaced object is easily hit; development trials
RARELY = 0.25
# weighted share of the draws in which removing an error must restore success: a majority
ENOUGH = 0.5
# m; five of six grasps survive 4 mm and 3 degrees, hindsight is off by 2 to 4 mm
TOLERANCE_M = 0.007
# m, likewise for a hand that never closed, where nothing can be tried again; ours
NEVER_CLOSED_M = 0.012
GAIN_LEAST = 0.15  # 1/s; a lower level gain is no servo at work; ours
# upright over level gain, or its inverse, beyond which the law is wrong; ours
GAINS_APART = 1.6
# times TOLERANCE_M; of a part that is to blame though the twin fails without it; ours
HUGE = 5.0
# probability where a part is blamed because it alone is off; chosen on development trials
ALONE = 0.7
# times TOLERANCE_M; no error of a hand under a wrong law is larger; ours
SMALL = 2.0
# times the next largest error, where several restore success or only all do; ours
CLEARLY, CLEARLY_ALL = 1.5, 2.0


Probabilities = tuple[float, float, float, float]


@dataclass(frozen=True)
class Draw:
    """What one draw of place, turn, friction and mass says of a failure.

    reproduced: the recorded failure happens in it. weight: how well it agrees with the log, 1 for
    the best. restored: by part of the system, whether the approach without that part's error alone
    lifts the object; "all": without any; "goal": of a hand that never closed, whether the grasp it
    was sent to would have held. t_contact_s: first contact that moves the object, from the
    reference; contact_link: the solid that made it.
    """

    verdict: Verdict
    facts: Facts
    reproduced: bool
    weight: float
    restored: dict[str, bool]
    t_contact_s: float | None
    contact_link: str | None


@dataclass(frozen=True)
class Draws:
    """The draws that were asked, the share of all draws that fail as recorded, the instrument.

    blind: probability that the instrument tells nothing of the trial, however its draws agree.
    softened: how often a draw was made again with half of the force, which pressed too deep.
    seen: of all draws, also of those not asked, what a person at the video sees
    (`failure_rule.observed`), and the draw's weight.
    """

    asked: tuple[Draw, ...]
    share_reproduced: float
    instrument: str
    blind: float = 0.0
    softened: int = 0
    seen: tuple[tuple[FailureClass, float], ...] = ()


@dataclass(frozen=True)
class Decision:
    """Class and sub-cause, or why they are unknown.

    probabilities: imprecise pose, collision, timing, unknown; their sum is 1. observed: likewise of
    the class that a person at the video would write.
    """

    answer: Verdict | Unknown
    probabilities: Probabilities
    draws: Draws
    observed: Probabilities = (0.0, 0.0, 0.0, 1.0)

    @property
    def observed_class(self) -> FailureClass | Unknown:
        """What a person at the video would write."""
        if self.observed[3] > 0.0:
            return Unknown("the draws do not agree on what a person would see")
        return CLASSES[int(np.argmax(self.observed))]

    @property
    def chosen(self) -> list[Draw]:
        """The draws that say the class of the answer; none if it is unknown."""
        if isinstance(self.answer, Unknown):
            return []
        return [d for d in self.draws.asked if d.verdict.failure_class == self.answer.failure_class]


@dataclass(frozen=True)
class Blame:
    """The part of the system to blame, or why it is unknown.

    part: servo, synthesis, velocity, tracking or execution. sizes: m, of all errors that are known
    (execution: s). source: where the beliefs come from; None where none were used.
    """

    part: str | Unknown
    probability: float
    sizes: dict[str, float]
    source: str | None


def undecided(reason: str, instrument: str) -> Decision:
    """The answer where no draw could be asked."""
    return Decision(Unknown(reason), (0.0, 0.0, 0.0, 1.0), Draws((), 0.0, instrument))


def too_uncertain(sd_m: float) -> Unknown | None:
    """Step 1: why a place with this standard deviation m says nothing; None where it does."""
    if sd_m > BLIND_SD_M:
        return Unknown(f"the object's place at the close is uncertain by {sd_m * 1000:.0f} mm")
    return None


def gave_way(held: bool, closed: bool, unseen_s: float) -> Unknown | None:
    """Step 1 of what someone holds: why its place says nothing; None where it does.

    closed: whether the hand closed. unseen_s: since it was last seen undisturbed, s. Of four
    simulated handovers without a close that were answered, three were answered wrongly.
    """
    if held and not closed:
        return Unknown(
            "someone holds the object, and the hand never closed: how it would have given way to a "
            "close is not known"
        )
    if held and unseen_s > HELD_UNSEEN_S:
        return Unknown(
            f"someone holds the object, and the hand was at it for {unseen_s:.1f} s: how far it "
            "gave way is not known"
        )
    return None


def decide(draws: Draws, min_probability: float) -> Decision:
    """Steps 3 to 5. min_probability: below which the answer is unknown."""
    asked = [(d.verdict.failure_class, d.weight) for d in draws.asked]
    p = (1 - draws.blind) * vote(asked) + draws.blind / len(CLASSES)
    best = int(np.argmax(p))
    doubt = doubt_of(draws, CLASSES[best], float(p[best]), min_probability)
    seen = (1 - draws.blind) * vote(draws.seen) + draws.blind / len(CLASSES)
    unclear = draws.share_reproduced < TRUSTED or float(seen.max()) < min_probability
    answer = lead_of(draws.asked, CLASSES[best]) if doubt is None else doubt
    return Decision(
        answer, _probabilities(p, doubt is not None), draws, _probabilities(seen, unclear)
    )


def _probabilities(p: Array, doubted: bool) -> Probabilities:
    """The shares (3,) of the classes, and the share of `unknown`: half where they are doubted."""
    unknown = 0.5 if doubted else 0.0
    return (*(float(share) * (1 - unknown) for share in p), unknown)  # type: ignore[return-value]


def vote(said: Sequence[tuple[FailureClass, float]]) -> Array:
    """Step 3: shares (3,) of the classes; draws by weight, and PRIOR draws for each class.

    said: class and weight of each draw.
    """
    votes = [sum(weight for name, weight in said if name == c) + PRIOR for c in CLASSES]
    return np.asarray(np.array(votes) / sum(votes))


def doubt_of(draws: Draws, best: FailureClass, p: float, min_probability: float) -> Unknown | None:
    """Step 4: why the winning class is not believed. None where it is."""
    share = draws.share_reproduced
    if share < TRUSTED:  # 4a: the instrument does not know this trial
        return Unknown(
            f"the recorded failure happens in only {share:.0%} of the draws of "
            f"the {draws.instrument}"
        )
    if best == "collision" and share < RARELY:  # 4b: only displaced objects are hit
        return Unknown(
            f"the hand hits the object in the {share:.0%} of the draws that end as "
            "recorded, and in the others all is well"
        )
    if p < min_probability:  # 4c: the draws disagree
        return Unknown(
            f"{best} is only {p:.0%} likely over {len(draws.asked)} draws of the object's place"
        )
    return None


def lead_of(asked: Sequence[Draw], best: FailureClass) -> Verdict:
    """Step 5: sub-cause of the first draw that fails as recorded, median shift of its like."""
    chosen = [d for d in asked if d.verdict.failure_class == best]
    lead = max(chosen, key=lambda d: d.reproduced).verdict
    alike = [d.verdict for d in chosen if d.verdict.sub_cause == lead.sub_cause]
    shifts = [v.shift_s for v in alike if v.shift_s is not None]
    return Verdict(best, lead.sub_cause, float(np.median(shifts)) if shifts else None)


def blame_of(decision: Decision, beliefs: Beliefs | Unknown) -> Blame:
    """Step 6: the part without whose error the same approach works; the first case that holds.

    Where no part is off by more than grasps survive, what the robot was after
    would have failed too (synthesis); where another close time lifts the object it is execution.
    """
    answer = decision.answer
    if isinstance(answer, Unknown):  # 6.1: no class, no part
        return Blame(Unknown("the class is unknown"), 0.0, {}, None)
    if isinstance(beliefs, Unknown):  # 6.2: beliefs not recorded
        return Blame(beliefs, 0.0, {}, None)
    sizes = {part: float(np.linalg.norm(e)) for part, e in beliefs.errors.items()}

    def blamed(part: str, probability: float) -> Blame:
        return Blame(part, probability, sizes, beliefs.source)

    def unknown(reason: str) -> Blame:
        return Blame(Unknown(reason), 0.0, sizes, beliefs.source)

    if answer.failure_class == "collision":  # 6.3: from the push on the beliefs follow it
        if wrong_law(beliefs):
            return blamed("servo", ALONE)
        return unknown("the object was pushed, and the robot believed what was pushed")
    chosen = decision.chosen
    if not chosen[0].facts.closed:  # 6.4: nothing was tried without an error
        return _never_closed(beliefs, sizes, chosen)
    shares = {part: _share(chosen, part) for part in (*sizes, "all")}
    large = sorted((p for p in sizes if sizes[p] > TOLERANCE_M), key=lambda p: -sizes[p])
    if answer.sub_cause == "early":  # a hand that closes before it is there is off because of that
        large = [part for part in large if part != "servo"]
    restoring = [part for part in large if shares[part] > ENOUGH]
    huge = [
        part
        for part in large[:1]
        if sizes[part] > HUGE * TOLERANCE_M
        and all(sizes[part] > CLEARLY_ALL * sizes[other] for other in large[1:])
    ]
    # 6.5: the servo's law is wrong, and no error is too large to come from it
    if wrong_law(beliefs) and not huge and all(sizes[p] < SMALL * TOLERANCE_M for p in restoring):
        return blamed("servo", ALONE)
    # 6.6: one part restores success, alone or far before the next
    if _stands_out(restoring, sizes, CLEARLY):
        return blamed(restoring[0], shares[restoring[0]])
    # 6.7: only all together restore it, and one is far the largest
    if shares["all"] > ENOUGH and _stands_out(large, sizes, CLEARLY_ALL):
        return blamed(large[0], shares["all"])
    if restoring:  # 6.8: several would do
        return unknown(f"removing any of {', '.join(sorted(restoring))} alone would do")
    if huge:  # 6.9: displaced by so much the approach is no longer like the recorded one
        return blamed(huge[0], ALONE)
    if answer.failure_class == "timing":  # 6.10: another close time would have done
        late = {"execution": abs(answer.shift_s or 0.0)}
        return Blame("execution", max(decision.probabilities), late, beliefs.source)
    if large:  # 6.11: errors, but none explains it; else the grasp itself was wrong
        return unknown(
            f"no part alone explains it, the largest is {large[0]} with "
            f"{sizes[large[0]] * 1000:.0f} mm"
        )
    return blamed("synthesis", 1.0 - max(shares.values()))


def _never_closed(beliefs: Beliefs, sizes: dict[str, float], chosen: Sequence[Draw]) -> Blame:
    """Case 6.4, of a hand that never closed: what kept it from a grasp that would have held."""
    goal = _share(chosen, "goal")
    off = [part for part in ("tracking", "velocity") if sizes.get(part, 0.0) > NEVER_CLOSED_M]
    off += ["servo"] if wrong_law(beliefs) else []
    if sizes["servo"] <= TOLERANCE_M and goal > ENOUGH:  # a: it was there and did not close
        return Blame("execution", goal, sizes, beliefs.source)
    if len(off) == 1:  # b: one part is off
        return Blame(off[0], ALONE, sizes, beliefs.source)
    if off:
        return Blame(Unknown(f"{', '.join(off)} are all off"), 0.0, sizes, beliefs.source)
    if sizes["servo"] <= TOLERANCE_M and beliefs.goal is not None:  # c: it was at a bad grasp
        return Blame("synthesis", 1.0 - goal, sizes, beliefs.source)
    why = (
        f"the hand came no nearer to its grasp than {sizes['servo'] * 1000:.0f} mm, "
        "and no part stands out"
    )
    return Blame(Unknown(why), 0.0, sizes, beliefs.source)


def _stands_out(parts: Sequence[str], sizes: dict[str, float], times: float) -> bool:
    """Whether the first of parts sorted by size is alone, or larger than the next by a factor."""
    return len(parts) == 1 or (len(parts) > 1 and sizes[parts[0]] > times * sizes[parts[1]])


def _share(chosen: Sequence[Draw], key: str) -> float:
    """Weighted share of the draws in which something restores success."""
    return sum(d.weight for d in chosen if d.restored.get(key)) / sum(d.weight for d in chosen)


def wrong_law(beliefs: Beliefs) -> bool:
    """Whether the commanded twist has one gain level and quite another one upright."""
    if beliefs.gains is None:
        return False
    level, upright = beliefs.gains
    return level > GAIN_LEAST and not 1 / GAINS_APART < upright / level < GAINS_APART
