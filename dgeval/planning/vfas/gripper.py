"""The two-jaw gripper that VFAS-Grasp's evaluator is shown: the trained one, or a log's own.

Its grasp frame has its origin between the fingertips, 10 mm behind their ends, +z the approach and
+x the closing direction (the paper's Figure 3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from dgeval.determinism import generator
from dgeval.geometry import Array, invert, transform
from dgeval.robots.described_hand import DescribedHand
from dgeval.robots.description import LinkShape
from dgeval.robots.hand import Hand, KnownHand, hand_for
from dgeval.robots.hand_geometry import HandGeometry
from dgeval.robots.hand_solids import surface_points

ALONG_AXIS = np.cos(np.radians(10.0))  # a frame nearer to the palm's axes lies along them; ours
ALIKE_M = 0.003  # m, on average; grippers whose links are so near to each other are alike; ours
COMPARED = 1000  # points of each gripper
SIDE_POINTS, BESIDE_M = 4000, 0.010  # points of a jaw; m along the approach; ours


@dataclass(frozen=True)
class Gripper:
    """A gripper as VFAS-Grasp sees it.

    T_palm_grasp (4, 4): its grasp frame in the palm's. opening m: between the open jaws. points: n
    points (n, 3) m on the open gripper's links, grasp frame, uniform by area. told: what it is.
    """

    T_palm_grasp: Array
    opening: float
    points: Callable[[int, np.random.Generator], Array]
    told: str


def trained_gripper() -> Gripper:
    """The gripper that the shipped weights were trained with."""
    hand = hand_for("vfas")
    assert hand.link_points is not None
    return Gripper(np.eye(4), hand.opening or 0.0, hand.link_points, hand.told)


def gripper_of(hand: Hand | None) -> Gripper | str:
    """The gripper of a log's hand; else why VFAS-Grasp can't take it for one."""
    if hand is None:
        return "the log has no hand that dgeval could make out"
    if isinstance(hand, KnownHand) and hand.link_points is not None:
        return Gripper(np.eye(4), hand.opening or 0.0, hand.link_points, hand.told)
    if not isinstance(hand, DescribedHand):
        return f"{hand.told} is no gripper of two jaws"
    tips = hand.geometry.tips_at(hand.geometry.open)
    if len(tips) != 2:
        return f"{hand.told} is no gripper of two jaws"
    T = invert(hand.T_hand_palm) @ _grasp_frame(hand, tips)
    for column in (2, 0):
        T[:3, column] = _along_an_axis(T[:3, column])
    if T[:3, 0].sum() < 0:  # a gripper is the same turned by half a turn: one of the two
        T[:3, 0] *= -1
    T[:3, 1] = np.cross(T[:3, 2], T[:3, 0])
    T_base_grasp = hand.T_hand_palm @ T
    fingers = _triangles(hand.geometry, T_base_grasp)
    whole = np.concatenate(list(fingers.values()))
    links = [link for link, _ in hand.geometry.tips]
    jaws = [fingers[next(f for f in fingers if link in f)] for link in links]
    return Gripper(T, _between(*jaws), partial(_sampled, whole), hand.told)


def apart(gripper: Gripper, other: Gripper) -> float:
    """Mean distance, m, from a point on either gripper to the nearest one on the other."""
    a, b = (g.points(COMPARED, generator(0, "grippers compared", 0)) for g in (gripper, other))
    near = np.concatenate([cKDTree(a).query(b)[0], cKDTree(b).query(a)[0]])
    return float(near.mean())


def _grasp_frame(hand: DescribedHand, tips: Array) -> Array:
    """(4, 4) in the hand's base: at the grasp's centre, across the fingertips (2, 3) m."""
    T = np.eye(4)
    closing = (tips[1] - tips[0]) / max(float(np.linalg.norm(tips[1] - tips[0])), 1e-9)
    ahead = hand.approach - closing * (closing @ hand.approach)
    approach = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    T[:3, :3] = np.stack([closing, np.cross(approach, closing), approach], axis=1)
    T[:3, 3] = hand.centre
    return T


def _along_an_axis(direction: Array) -> Array:
    """The axis of the frame that a direction (3,) is given in, where it is near to one."""
    k = int(np.argmax(np.abs(direction)))
    if abs(direction[k]) < ALONG_AXIS:
        return direction
    axis = np.zeros(3)
    axis[k] = np.sign(direction[k])
    return axis


def _triangles(geometry: HandGeometry, T_base_grasp: Array) -> dict[tuple[str, ...], Array]:
    """By finger, (n, 3, 3) m: the corners of its open surface, grasp frame."""
    T_grasp_base = invert(T_base_grasp)
    fingers: dict[tuple[str, ...], list[Array]] = {}
    for shape, T in geometry.shapes(geometry.open):
        finger = next((f for f in geometry.links.fingers if shape.link in f), None)
        if finger is not None:
            corners = transform(T_grasp_base @ T, _surface(shape).reshape(-1, 3))
            fingers.setdefault(finger, []).append(corners.reshape(-1, 3, 3))
    return {finger: np.concatenate(listed) for finger, listed in fingers.items()}


def _between(jaw: Array, other: Array) -> float:
    """m, along x, between the inner sides of two jaws (n, 3, 3) beside the grasp's origin."""
    sides = []
    for triangles in (jaw, other):
        points = _sampled(triangles, SIDE_POINTS, generator(0, "opening", 0))
        near = points[np.abs(points[:, 2]) < BESIDE_M, 0]
        sides.append(near if len(near) else points[:, 0])
    left, right = sorted(sides, key=lambda x: float(x.mean()))
    return float(max(0.0, right.min() - left.max()))


def _surface(shape: LinkShape) -> Array:
    """Triangles (n, 3, 3) m of a solid, in its own frame; of one that is round, of its corners."""
    if shape.mesh is not None:
        vertices, faces = shape.mesh
        return np.asarray(vertices[faces], dtype=np.float64)
    corners = surface_points(shape, in_link=False)
    return np.asarray(corners[ConvexHull(corners).simplices])


def _sampled(triangles: Array, n: int, rng: np.random.Generator) -> Array:
    """Points (n, 3) on triangles (m, 3, 3), uniform by area."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(triangles), n, p=area / area.sum())
    u, v = rng.uniform(0, 1, (2, n, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return np.asarray(a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen])
