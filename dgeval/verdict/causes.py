"""Why a grasp failed: the rule of `taxonomy` over what an instrument finds out, for several draws of what is uncertain.

Two instruments: the twin (physics), and geometry alone, which asks whether the object lies where the hand closes. Over 227
simulated failures that set nothing the twin has macro-F1 0.82, geometry 0.42 (`benchmarks/results/verdict.md`), so the twin
is the default; what neither can be run on is `unknown`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgeval.determinism import generator
from dgeval.geometry import Array, rotation_angle
from dgeval.physics.closing import AFTER_CLOSE_S, CONTROL_S
from dgeval.physics.shape import solid_from_cloud
from dgeval.taxonomy import Facts, FailureClass, Needs, SubCause, Thresholds, Verdict, classify
from dgeval.verdict.evidence import Scene
from dgeval.verdict.twin import Sample, Twin

CLASSES: tuple[FailureClass, ...] = ("imprecise_pose", "collision", "timing")
NOT_REPRODUCED = 0.3  # weight of a draw in which the recorded failure does not happen
PRIOR = 0.3  # of each class, in draws: three that agree were right in 57 of 66 failures, two of three in 2 of 8
TRIES = 4  # draws of the place for each one wanted, to find ones in which the recorded failure happens
TRUSTED = 0.05  # share of draws in which the recorded failure happens, below which the instrument is not believed
SD_LEAST_M, SD_LEAST_DEG = 0.0015, 1.0  # nothing is known better than that
SD_MOST_M, SD_MOST_DEG = 0.006, 5.0
SD_FRICTION, SD_MASS = 0.15, 0.7  # of logarithms; a log does not weigh: household things have 70 to 900 kg/m^3
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


def cause_of(scene: Scene, method: str, draws: int, seed: int, least: float, thresholds: Thresholds) -> Cause:
    """The class of a failed grasp. `least`: probability under which the answer is unknown."""
    if scene.sd_m > BLIND_SD_M:
        why = f"the object's place at the close is uncertain by {scene.sd_m * 1000:.0f} mm"
        return Cause("unknown", (0.0, 0.0, 0.0, 1.0), None, None, (), 0.0, method, why)
    geometry = method == "geometry"
    samples, tries = ([_geometry(scene, thresholds)], 1) if geometry else _twins(scene, draws, seed, thresholds)
    weights = np.array([1.0 if s.reproduced else NOT_REPRODUCED for s in samples])
    votes = [float(weights[[s.verdict.failure_class == c for s in samples]].sum()) + PRIOR for c in CLASSES]
    p = np.array(votes) / sum(votes)
    reproduced = sum(s.reproduced for s in samples) / tries
    best = int(np.argmax(p))
    chosen = [s for s in samples if s.verdict.failure_class == CLASSES[best]]
    lead = max(chosen, key=lambda s: s.reproduced)
    doubt = None
    if reproduced < TRUSTED:
        doubt = f"the recorded failure happens in only {reproduced:.0%} of {tries} draws of the {method}"
    elif p[best] < least:
        doubt = f"{CLASSES[best]} is only {p[best]:.0%} likely over {len(samples)} draws of the object's place"
    if doubt is not None:
        chances = (float(p[0]) / 2, float(p[1]) / 2, float(p[2]) / 2, 0.5)
        return Cause("unknown", chances, None, None, tuple(samples), reproduced, method, doubt)
    alike = [s.verdict for s in chosen if s.verdict.sub_cause == lead.verdict.sub_cause]
    shifts = [v.shift_s for v in alike if v.shift_s is not None]
    shift = float(np.median(shifts)) if shifts else None
    chances = (float(p[0]), float(p[1]), float(p[2]), 0.0)
    return Cause(CLASSES[best], chances, lead.verdict.sub_cause, shift, tuple(samples), reproduced, method)


def _twins(scene: Scene, draws: int, seed: int, thresholds: Thresholds) -> tuple[list[Sample], int]:
    """What the draws say, and how many were tried.

    That it failed is known, so draws of the place in which it would not have are doubtful. Where some are, further and wider
    draws are tried for ones in which it does, up to TRIES per draw wanted.
    """
    solid = solid_from_cloud(scene.points)
    sd_m = float(np.clip(scene.sd_m, SD_LEAST_M, SD_MOST_M))
    sd_turn = np.radians(float(np.clip(scene.sd_deg, SD_LEAST_DEG, SD_MOST_DEG)))
    samples: list[Sample] = []
    k = 0
    while k < draws or (k < TRIES * draws and sum(s.reproduced for s in samples) < draws):
        rng = generator(seed, "verdict", k)
        wider = 1.0 if k < draws else 2.0
        dx, dy = rng.normal(0, wider * sd_m, 2)
        turn, friction, mass = rng.normal(0, wider * sd_turn), *np.exp(rng.normal(0, [SD_FRICTION, SD_MASS]))
        if k == 0:  # the first draw is the best guess
            dx, dy, turn, friction, mass = 0.0, 0.0, 0.0, 1.0, 1.0
        twin = Twin(scene, solid, (float(dx), float(dy), float(turn)), float(friction), float(mass))
        reproduced = twin.approach()
        if reproduced or k < draws:
            samples.append(twin.decide(thresholds, reproduced))
        k += 1
    return samples, k


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
                off[k] = np.linalg.norm(real_now - free[k]), np.degrees(rotation_angle(last[:3, :3]))
            held = real_now - free[k]
        real[k] = free[k] + (held if last is not None else 0.0)
    works = np.linalg.norm(places - real, axis=1) < REACH_M
    velocity = (places[end] - places[max(end - 5, 0)]) / (5 * CONTROL_S)
    curve = [((k - end) * CONTROL_S, bool(works[k])) for k in range(end % 3, end + 1, 3) if k != end or scene.close is None]
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
    return Sample(answer, facts, True, facts.contact_s, None)
