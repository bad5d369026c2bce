"""Why a grasp failed: the rule of `taxonomy` over what an instrument finds out, for several draws of what is uncertain.

Two instruments: the twin (physics), and geometry alone, which asks whether the object lies where the hand closes. Over 232
simulated failures that set nothing the twin has macro-F1 0.81, geometry 0.42 (`benchmarks/results/verdict.md`), so the twin
is the default; what neither can be run on is `unknown`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgeval.determinism import generator
from dgeval.failure_rule import (
    HANDED_OVER,
    Facts,
    FailureClass,
    Needs,
    SubCause,
    Thresholds,
    Verdict,
    classify,
)
from dgeval.geometry import Array, rotation_angle
from dgeval.verdict.evidence import Scene
from dgeval.verdict.twin import Sample, Twin
from dgeval.worlds.closing import AFTER_CLOSE_S, CONTROL_S
from dgeval.worlds.shape import solid_from_cloud

CLASSES: tuple[FailureClass, ...] = ("imprecise_pose", "collision", "timing")
NOT_REPRODUCED = 0.3  # weight of a draw in which the recorded failure does not happen
PRIOR = 0.15  # of each class, in draws; chosen on development trials, where three that agree are right in 9 of 10
PROBES = 12  # draws in which the recorded approach and close are tried, the later half of them twice as wide
PROBES_MOST = 30  # where few of them agree with the log
MOST = 7  # draws that are asked, where fewer do not agree
MISMATCH_SD = {"fingers": 0.03, "jaw": 0.002}  # rad, m; of where the closing fingers come to rest
STRAYED_SD = 0.002  # m; of where the object is while the hand is at it
TRUSTED = 0.05  # share of draws in which the recorded failure happens, below which the instrument is not believed
RARELY = 0.25  # likewise for a collision: an object displaced until the grasp fails is easily one that the hand hits
SD_LEAST_M, SD_LEAST_DEG = 0.0015, 1.0  # nothing is known better than that
SD_MOST_M, SD_MOST_DEG = 0.006, 5.0
SD_FRICTION, SD_MASS = (
    0.15,
    0.7,
)  # of logarithms; a log does not weigh: household things have 70 to 900 kg/m^3
REACH_M = 0.035  # geometry: object's middle from the hand's grasp centre
NEAR_M = 0.15  # geometry: farther than this from its grasp centre a hand pushes nothing
BLIND_SD_M = 0.025  # with the place less certain than this nothing can be said


@dataclass(frozen=True)
class Cause:
    """Class with probabilities (imprecise pose, collision, timing, unknown; sum 1), and the draws it rests on."""

    failure_class: FailureClass
    probabilities: tuple[float, float, float, float]
    sub_cause: SubCause | None
    shift_s: float | None
    samples: tuple[Sample, ...]
    reproduced: float
    instrument: str
    why_unknown: str | None = None


def cause_of(scene: Scene, method: str, draws: int, seed: int, least: float) -> Cause:
    """The class of a failed grasp. `least`: probability under which the answer is unknown."""
    thresholds = HANDED_OVER if scene.held else Thresholds()
    if scene.sd_m > BLIND_SD_M:
        why = f"the object's place at the close is uncertain by {scene.sd_m * 1000:.0f} mm"
        return Cause("unknown", (0.0, 0.0, 0.0, 1.0), None, None, (), 0.0, method, why)
    geometry = method == "geometry"
    samples, reproduced = (
        ([_geometry(scene, thresholds)], 1.0)
        if geometry
        else _twins(scene, draws, seed, thresholds)
    )
    weights = np.array([s.weight for s in samples])
    votes = [
        float(weights[[s.verdict.failure_class == c for s in samples]].sum()) + PRIOR
        for c in CLASSES
    ]
    p = np.array(votes) / sum(votes)
    best = int(np.argmax(p))
    chosen = [s for s in samples if s.verdict.failure_class == CLASSES[best]]
    lead = max(chosen, key=lambda s: s.reproduced)
    doubt = None
    if reproduced < TRUSTED:
        doubt = (
            f"the recorded failure happens in only {reproduced:.0%} of the draws of the {method}"
        )
    elif CLASSES[best] == "collision" and reproduced < RARELY:
        doubt = f"the hand hits the object in the {reproduced:.0%} of the draws that end as recorded, and in the others all is well"
    elif p[best] < least:
        doubt = f"{CLASSES[best]} is only {p[best]:.0%} likely over {len(samples)} draws of the object's place"
    if doubt is not None:
        chances = (float(p[0]) / 2, float(p[1]) / 2, float(p[2]) / 2, 0.5)
        return Cause("unknown", chances, None, None, tuple(samples), reproduced, method, doubt)
    alike = [s.verdict for s in chosen if s.verdict.sub_cause == lead.verdict.sub_cause]
    shifts = [v.shift_s for v in alike if v.shift_s is not None]
    shift = float(np.median(shifts)) if shifts else None
    chances = (float(p[0]), float(p[1]), float(p[2]), 0.0)
    return Cause(
        CLASSES[best], chances, lead.verdict.sub_cause, shift, tuple(samples), reproduced, method
    )


def _twins(
    scene: Scene, draws: int, seed: int, thresholds: Thresholds
) -> tuple[list[Sample], float]:
    """What the draws say that agree best with the log, and the share of all in which the recorded failure happens.

    That it failed is known, and so is how far each finger came when the hand closed: a draw in which it would have held, or
    in which the fingers meet the object elsewhere, is doubtful. Only the recorded approach is tried for each draw; the
    questions of the rule are asked of the best ones, of `draws` where these agree, else of up to MOST.
    """
    solid = solid_from_cloud(scene.points, held=scene.held)
    sd_m = float(np.clip(scene.sd_m, SD_LEAST_M, SD_MOST_M))
    sd_turn = np.radians(float(np.clip(scene.sd_deg, SD_LEAST_DEG, SD_MOST_DEG)))
    probes: list[tuple[Twin, bool]] = []
    weights = np.zeros(0)
    while len(probes) < PROBES or (
        weights.sum() / weights.max() < draws and len(probes) < PROBES_MOST
    ):
        k = len(probes)
        rng = generator(seed, "verdict", k)
        wider = 1.0 if k < PROBES // 2 else 2.0
        dx, dy = rng.normal(0, wider * sd_m, 2)
        turn, friction, mass = (
            rng.normal(0, wider * sd_turn),
            *np.exp(rng.normal(0, [SD_FRICTION, SD_MASS])),
        )
        if k == 0:  # the first draw is the best guess
            dx, dy, turn, friction, mass = 0.0, 0.0, 0.0, 1.0, 1.0
        twin = Twin(scene, solid, (float(dx), float(dy), float(turn)), float(friction), float(mass))
        probes.append((twin, twin.approach()))
        off = np.array(
            [
                [t.mismatch / MISMATCH_SD[scene.gripper.name], t.strayed / STRAYED_SD]
                for t, _ in probes
            ]
        )
        fit = np.exp(-0.5 * ((off - off.min(axis=0)) ** 2).sum(axis=1))
        weights = fit * [1.0 if reproduced else NOT_REPRODUCED for _, reproduced in probes]
    samples: list[Sample] = []
    for k in sorted(range(len(probes)), key=lambda k: -weights[k])[: max(MOST, draws)]:
        twin, reproduced = probes[k]
        samples.append(twin.decide(thresholds, reproduced, float(weights[k] / weights.max())))
        if len(samples) >= draws and len({s.verdict.failure_class for s in samples}) == 1:
            break
    return samples, sum(reproduced for _, reproduced in probes) / len(probes)


def _geometry(scene: Scene, thresholds: Thresholds) -> Sample:
    """The same rule with 'the object's middle lies where the hand closes' in place of 'closing and lifting works'."""
    end = scene.reference
    centre = (scene.points.min(axis=0) + scene.points.max(axis=0)) / 2
    T = scene.hand.T_support_hand
    places = np.array([T[k][:3, :3] @ scene.gripper.centre + T[k][:3, 3] for k in range(end + 1)])
    free = centre + scene.free[: end + 1]
    real = free.copy()
    off = np.zeros((end + 1, 2))
    last: Array | None = None
    for k in range(end + 1):
        if np.isfinite(scene.seen[k, 0, 0]):
            last = scene.seen[k]
            real_now = last[:3, :3] @ centre + last[:3, 3]
            if np.linalg.norm(places[k] - real_now) < NEAR_M:
                off[k] = (
                    np.linalg.norm(real_now - free[k]),
                    np.degrees(rotation_angle(last[:3, :3])),
                )
            held = real_now - free[k]
        real[k] = free[k] + (held if last is not None else 0.0)
    works = np.linalg.norm(places - real, axis=1) < REACH_M
    velocity = (places[end] - places[max(end - 5, 0)]) / (5 * CONTROL_S)
    curve = [
        ((k - end) * CONTROL_S, bool(works[k]))
        for k in range(end % 3, end + 1, 3)
        if k != end or scene.close is None
    ]
    if scene.close is not None:
        curve.append((0.0, False))
        for k in range(3, round(AFTER_CLOSE_S / CONTROL_S) + 1, 3):
            dt = k * CONTROL_S
            gap = places[end] + velocity * dt - real[end] - scene.velocity * dt
            curve.append((dt, bool(np.linalg.norm(gap) < REACH_M)))
    pushed = np.flatnonzero((off[:, 0] > 0.003) | (off[:, 1] > 3.0))
    facts = Facts(
        scene.close is not None, float(np.sort(off[:, 0])[-3:].min()), float(np.sort(off[:, 1])[-3:].min()), tuple(curve),
        float((pushed[0] - end) * CONTROL_S) if len(pushed) else None, 0.0,
    )  # fmt: skip
    while isinstance(answer := classify(facts, thresholds), Needs):
        ok = bool(np.linalg.norm(places[end] - free[end]) < REACH_M)
        facts = replace(facts, put_back=ok, free_pose=ok)
    assert isinstance(answer, Verdict)
    return Sample(answer, facts, True, 1.0, {}, facts.contact_s, None)
