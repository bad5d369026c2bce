"""The failure rule by geometry alone: a close works where the object's middle lies in the grasp.

It is the yardstick that the twin is held against, and runs where MuJoCo does not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgeval.failure_rule import Facts, Needs, Seen, Thresholds, Verdict, classify
from dgeval.geometry import Array, rotation_angle
from dgeval.verdict.decide import Draw
from dgeval.verdict.evidence import Scene
from dgeval.worlds.closing import AFTER_CLOSE_S, CONTROL_S

REACH_M = 0.035  # m; object's middle from the hand's grasp centre, within which a close works
# m and degrees; an object that is farther off its path was pushed: twice hindsight's error; ours
PUSHED_M, PUSHED_DEG = 0.003, 3.0
NEAR_M = 0.15  # m; farther than this from its grasp centre a hand pushes nothing


def geometric_draw(scene: Scene, thresholds: Thresholds) -> tuple[Draw, Seen]:
    """The failure rule where a close works if the object's middle lies in the grasp.

    Also what a person at the video sees, if that ball is the region that the hand closes in and the
    middle the whole object: it is between the fingers where it is in the grasp.
    """
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
            off_path = real_now - free[k]
        real[k] = free[k] + (off_path if last is not None else 0.0)
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
    pushed = np.flatnonzero((off[:, 0] > PUSHED_M) | (off[:, 1] > PUSHED_DEG))
    facts = Facts(
        scene.close is not None,
        float(np.sort(off[:, 0])[-3:].min()),
        float(np.sort(off[:, 1])[-3:].min()),
        tuple(curve),
        float((pushed[0] - end) * CONTROL_S) if len(pushed) else None,
        0.0,
    )
    while isinstance(answer := classify(facts, thresholds), Needs):
        ok = bool(np.linalg.norm(places[end] - free[end]) < REACH_M)
        facts = replace(facts, put_back=ok, free_pose=ok)
    assert isinstance(answer, Verdict)
    far = np.linalg.norm(places - real, axis=1)
    # a closing hand goes with the object: all stays what it is at the close
    periods = range(end + 1 + (0 if scene.close is None else round(AFTER_CLOSE_S / CONTROL_S)))
    inside = REACH_M - far
    reach = [
        ((k - end) * CONTROL_S, float(inside[min(k, end)] > 0), float(inside[min(k, end)]))
        for k in periods
    ]
    seen = Seen(
        facts.closed,
        len(pushed) > 0,
        facts.displacement_m,
        facts.displacement_deg,
        tuple(reach),
        None if scene.close is None else 0.0,
    )
    return Draw(answer, facts, True, 1.0, {}, facts.contact_s, None), seen
