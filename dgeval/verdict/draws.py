"""Draws of what is uncertain, and what an instrument says of each.

Two instruments: the twin (physics), and geometry alone. Over 232 simulated failures the twin has
macro-F1 0.81 and geometry 0.42 (`benchmarks/results/verdict.md`), so the twin is the default.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import QhullError

from dgeval.determinism import generator
from dgeval.failure_rule import HANDED_OVER, Thresholds, Unknown, observed
from dgeval.geometry import Array
from dgeval.robots.described_hand import FORCE_N, LEAST_FORCE_N, DescribedHand
from dgeval.robots.hand import Hand
from dgeval.verdict.decide import (
    Decision,
    Draw,
    Draws,
    decide,
    gave_way,
    too_uncertain,
    undecided,
)
from dgeval.verdict.evidence import Scene
from dgeval.verdict.geometric import geometric_draw
from dgeval.verdict.recorded_closing import slowed
from dgeval.verdict.twin import Twin
from dgeval.worlds.hand_and_object import UnstableError
from dgeval.worlds.shape import solid_from_cloud

# weight of a draw in which the recorded failure does not happen; ours
NOT_REPRODUCED = 0.3
# draws in which the recorded approach and close are tried, the later half twice as wide
PROBES = 12
PROBES_MOST = 30  # draws, where few of them agree with the log
MOST = 7  # draws that are asked, where fewer do not agree
# m; of where the object is while the hand is at it; ours
STRAYED_SD = 0.002
SD_LEAST_M, SD_LEAST_DEG = 0.0015, 1.0  # nothing is known better than that; ours
# draws are no wider than that; ours
SD_MOST_M, SD_MOST_DEG = 0.006, 5.0
# probability that a hand that is known by its description alone tells nothing: of 326 answers about
# a Panda, a 2F-85 and an Allegro 80 % are right, where 81 % is said so
# (`benchmarks/results/other_hands.md`)
BLIND_DESCRIBED = 0.15
# the same of what someone holds, as how a person gives way is not modelled: of nine simulated
# handovers that closed six were right, where 91 % was said (benchmarks/results/verdict-handover.md)
BLIND_HELD = 0.3
# m of hand and object into each other in closing, beyond which a force that is not known was too
# large: 60 N of a 2F-85 press 4.3 mm into an apple, 15 N 1.2 mm; in steps of 1 and 0.5 ms as deep
# as in those of 2 ms, so that only less force helps
PRESSED_M = 0.002
SD_CLOSE = 0.4  # of the logarithm of a close's time that no trial shows; ours
SD_FRICTION, SD_MASS = 0.15, 0.7  # of logarithms; household objects have 70 to 900 kg/m^3


def decide_scene(
    scene: Scene, method: str, draws: int, seed: int, min_probability: float
) -> Decision | Unknown:
    """Class of a failed grasp: steps 1 to 5 of `decide`, with draws from an instrument.

    method: twin or geometry. min_probability: below which the answer is unknown. `Unknown` where
    the instrument can't be asked at all.
    """
    doubt = too_uncertain(scene.sd_m) or gave_way(
        scene.held, scene.close is not None, scene.unseen_s(scene.reference)
    )
    if doubt is not None:
        return undecided(doubt.reason, method)
    made = draws_of(scene, method, draws, seed)
    return made if isinstance(made, Unknown) else decide(made, min_probability)


def draws_of(scene: Scene, method: str, draws: int, seed: int) -> Draws | Unknown:
    """The draws of an instrument; unknown where the object's cloud makes no solid."""
    thresholds = HANDED_OVER if scene.held else Thresholds()
    try:
        if method == "geometry":
            draw, seen = geometric_draw(scene, thresholds)
            return Draws((draw,), 1.0, method, seen=((observed(seen, thresholds), 1.0),))
        return _twins(scene, draws, seed, thresholds)
    # no points, a cloud or fingers that span no volume, or that MuJoCo refuses
    except (ValueError, QhullError) as error:
        return Unknown(str(error))


def _twins(scene: Scene, draws: int, seed: int, thresholds: Thresholds) -> Draws:
    """What the draws say that agree best with the log, and the share of all that fail as recorded.

    That it failed is known, and so is how far each finger came when the hand closed: a draw in
    which it would have held, or in which the fingers meet the object elsewhere, is doubtful. Only
    the recorded approach is tried for each draw; the questions of the rule are asked of the best
    ones, of `draws` where these agree, else of up to MOST.
    """
    solid = solid_from_cloud(scene.points, held=scene.held)
    sd_m = float(np.clip(scene.sd_m, SD_LEAST_M, SD_MOST_M))
    sd_turn = np.radians(float(np.clip(scene.sd_deg, SD_LEAST_DEG, SD_MOST_DEG)))
    described = isinstance(scene.gripper, DescribedHand)
    softened = 0
    probes: list[tuple[Twin, bool]] = []
    likely: list[float] = []
    weights = np.zeros(0)
    for k in range(PROBES_MOST):
        if k >= PROBES and len(probes) and weights.sum() / weights.max() >= draws:
            break
        rng = generator(seed, "verdict", k)
        wider = 1.0 if k < PROBES // 2 else 2.0
        dx, dy = rng.normal(0, wider * sd_m, 2)
        turn = rng.normal(0, wider * sd_turn)
        friction, mass = np.exp(rng.normal(0, [SD_FRICTION, SD_MASS]))
        if k == 0:  # the first draw is the best guess
            dx, dy, turn, friction, mass = 0.0, 0.0, 0.0, 1.0, 1.0
        offset = (float(dx), float(dy), float(turn))
        force = _force(scene.gripper, rng, k)
        drawn = _pace(scene, rng, k)
        try:
            twin = Twin(drawn, solid, offset, float(friction), float(mass), force)
            reproduced = twin.approach()
            while described and twin.pressed > PRESSED_M and force > LEAST_FORCE_N / FORCE_N:
                force, softened = 0.5 * force, softened + 1
                twin = Twin(drawn, solid, offset, float(friction), float(mass), force)
                reproduced = twin.approach()
        except UnstableError:
            continue
        probes.append((twin, reproduced))
        likely.append(_likely(np.array([dx / sd_m, dy / sd_m, turn / sd_turn])))
        off = np.array(
            [[t.mismatch / scene.gripper.mismatch_sd, t.strayed / STRAYED_SD] for t, _ in probes]
        )
        fit = np.exp(-0.5 * ((off - off.min(axis=0)) ** 2).sum(axis=1))
        weights = fit * likely * [1.0 if reproduced else NOT_REPRODUCED for _, reproduced in probes]
    asked: list[Draw] = []
    for k in sorted(range(len(probes)), key=lambda k: -weights[k])[: max(MOST, draws)]:
        twin, reproduced = probes[k]
        try:
            asked.append(twin.ask(thresholds, reproduced, float(weights[k] / weights.max())))
        except UnstableError:
            continue
        if len(asked) >= draws and len({d.verdict.failure_class for d in asked}) == 1:
            break
    if not asked:
        raise ValueError("the physics of this hand at this object is unstable in every draw")
    share = sum(reproduced for _, reproduced in probes) / len(probes)
    blind = max(BLIND_DESCRIBED * described, BLIND_HELD * scene.held)
    best = float(weights.max())
    seen = tuple(
        (observed(twin.seen, thresholds), float(w) / best)
        for (twin, _), w in zip(probes, weights, strict=True)
    )
    return Draws(tuple(asked), share, "twin", blind, softened, seen)


def _likely(off: Array) -> float:
    """How much a draw counts by its place, off (3,) standard deviations from the best guess: the
    normal density over that of the draws, half of which are twice as wide; 1.8 where nothing is
    off, nearly 0 from 4 on.
    """
    square = float(off @ off)
    narrow, wide = np.exp(-0.5 * square), np.exp(-0.125 * square) / 8
    return float(2 * narrow / (narrow + wide))


def _pace(scene: Scene, rng: np.random.Generator, k: int) -> Scene:
    """The scene of a draw whose hand closes faster or slower, where no trial shows how it closes:
    what is set, or the way to the limits, is no more than a guess of its time.
    """
    hand = scene.gripper
    if not isinstance(hand, DescribedHand) or hand.closing_source not in ("set", "limits"):
        return scene
    factor = float(np.exp(rng.normal(0, SD_CLOSE)))
    return scene if k == 0 else replace(scene, gripper=slowed(hand, factor))


def _force(gripper: Hand, rng: np.random.Generator, k: int) -> float:
    """Factor on the drives' forces of a draw, log-uniform, of a hand whose force is not known."""
    if not isinstance(gripper, DescribedHand):
        return 1.0
    least, most = np.array(gripper.force_n) / FORCE_N
    if k == 0:
        return float(np.clip(1.0, least, most))
    return float(np.exp(rng.uniform(*np.log([least, most]))))
