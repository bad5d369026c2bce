"""Whether an arm can bring its palm to a pose: inverse kinematics within the joint limits.

The arm is read from the robot's description. Replay and simulator ask the same solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dgeval.determinism import generator
from dgeval.geometry import Array
from dgeval.robots.description import Description, Joint

POSITION_M, ANGLE_RAD = 0.001, 0.01  # m, rad; a pose is reached when both errors are below these
WEIGHT = 0.1  # m/rad, weight of the rotation error against the position error
# searches of a pose: the first from where the arm is, the others from drawn joint positions; and
# steps of one search. "No" is said when all have failed
STARTS, STEPS = 20, 60
MOST_STEP = 0.5  # rad or m, of a joint in one step
TURN = np.pi  # rad to each side from which a joint without limits is drawn


@dataclass(frozen=True)
class Arm:
    """The joints from the link `base` to the palm in order, including fixed ones."""

    joints: tuple[Joint, ...]
    base: str

    @property
    def movable(self) -> list[Joint]:
        """The joints that are not fixed, in order."""
        return [j for j in self.joints if j.kind != "fixed"]

    @cached_property
    def _chain(self) -> tuple[Array, Array, NDArray[np.bool_], Array, Array, Array]:
        """Of the movable joints: origins (n, 4, 4) with the fixed ones before them, axes (n, 3),
        which slide, and limits (n,); then the palm (4, 4) on the last of them.
        """
        origins, T = [], np.eye(4)
        for joint in self.joints:
            T = T @ joint.origin
            if joint.kind != "fixed":
                origins.append(T)
                T = np.eye(4)
        movable = self.movable
        axes = np.array([j.axis for j in movable], dtype=np.float64)
        slides = np.array([j.kind == "prismatic" for j in movable])
        low, high = (np.array([getattr(j, e) for j in movable]) for e in ("lower", "upper"))
        return np.array(origins), axes, slides, low, high, T

    def palm(self, q: Array) -> tuple[Array, Array]:
        """T_base_palm (4, 4) at joint positions (n,) rad or m, and its Jacobian (6, n).

        The Jacobian is in base axes, at the palm's origin; linear velocity first.
        """
        origins, axes, slides, _, _, tool = self._chain
        T, J = _forward(origins, axes, slides, tool, np.asarray(q, dtype=np.float64))
        return np.asarray(T), np.asarray(J)

    def solve(self, T_base_palm: Array, q: Array) -> Array | None:
        """Joint positions (n,) within the limits that bring the palm to a pose (4, 4), or None.

        The search starts at q (n,), then at STARTS - 1 drawn positions, the same ones for any pose.
        """
        origins, axes, slides, low, high, tool = self._chain
        target = np.ascontiguousarray(T_base_palm, dtype=np.float64)
        for start in (np.asarray(q, dtype=np.float64), *self._starts):
            found, is_reached = _search(
                origins, axes, slides, low, high, tool, target, np.clip(start, low, high)
            )
            if is_reached:
                return np.asarray(found)
        return None

    def room(self, q: Array) -> float:
        """How far joint positions (n,) are from the limits: 1 in the middle of all, 0 at one.

        The least over the joints; a joint without limits counts as in the middle.
        """
        low, high = self._chain[3], self._chain[4]
        wide = np.isfinite(high - low) & (high > low)
        if not wide.any():
            return 1.0
        nearest = np.minimum(q - low, high - q)[wide] / (high - low)[wide]
        return float(2 * nearest.min())

    @cached_property
    def _starts(self) -> Array:
        """(STARTS - 1, n) joint positions within the limits."""
        low, high = self._chain[3], self._chain[4]
        low, high = np.maximum(low, -TURN), np.minimum(high, TURN)
        n = len(low)
        return generator(0, "reach", n).uniform(low, np.maximum(low, high), (STARTS - 1, n))


@njit(cache=True)
def _forward(
    origins: Array, axes: Array, slides: NDArray[np.bool_], tool: Array, q: Array
) -> tuple[Array, Array]:
    """T_base_palm (4, 4) and its Jacobian (6, n)."""
    n = len(q)
    T, J = np.eye(4), np.zeros((6, n))
    places, directions = np.empty((n, 3)), np.empty((n, 3))
    for k in range(n):
        T = T @ origins[k]
        axis = axes[k]
        directions[k] = np.ascontiguousarray(T[:3, :3]) @ axis
        places[k] = T[:3, 3]
        if slides[k]:
            T[:3, 3] += q[k] * directions[k]
            continue
        x, y, z = axis
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        R = np.eye(4)
        R[:3, :3] += np.sin(q[k]) * K + (1 - np.cos(q[k])) * (K @ K)
        T = T @ R
    T = T @ tool
    for k in range(n):
        if slides[k]:
            J[:3, k] = directions[k]
        else:
            J[:3, k] = np.cross(directions[k], T[:3, 3] - places[k])
            J[3:, k] = directions[k]
    return T, J


@njit(cache=True)
def _apart(T: Array, target: Array) -> Array:
    """(6,): the way from a pose to another one, m, and the turn, rad, base axes."""
    out = np.empty(6)
    out[:3] = target[:3, 3] - T[:3, 3]
    R = np.ascontiguousarray(target[:3, :3]) @ np.ascontiguousarray(T[:3, :3]).T
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine, cosine = np.sqrt((v * v).sum()), (R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2
    if sine > 1e-9:
        v *= np.arctan2(sine, cosine) / sine
    elif cosine < 0:  # half a turn: any axis of it
        k = 0
        for i in range(1, 3):
            if R[i, i] > R[k, k]:
                k = i
        axis = (R[:, k] + np.eye(3)[k]) / 2
        v = np.pi * axis / np.sqrt((axis * axis).sum())
    out[3:] = v
    return out


@njit(cache=True)
def _search(
    origins: Array,
    axes: Array,
    slides: NDArray[np.bool_],
    low: Array,
    high: Array,
    tool: Array,
    target: Array,
    q: Array,
) -> tuple[Array, bool]:
    """Levenberg-Marquardt within limits from q (n,): where it ends, and whether it is the pose."""
    scale = np.array([1.0, 1.0, 1.0, WEIGHT, WEIGHT, WEIGHT])
    q, damping = q.copy(), 1e-3
    T, J = _forward(origins, axes, slides, tool, q)
    apart = _apart(T, target)
    for _ in range(STEPS):
        if (
            np.sqrt((apart[:3] ** 2).sum()) < POSITION_M
            and np.sqrt((apart[3:] ** 2).sum()) < ANGLE_RAD
        ):
            return q, True
        error = apart * scale
        cost = (error * error).sum()
        weighted = J * scale.reshape(6, 1)
        free = np.ones(len(q))
        step = np.zeros(len(q))
        for _again in range(3):  # a joint that is pressed against its limit does not take part
            A = weighted * free
            step = A.T @ np.linalg.solve(A @ A.T + damping * np.eye(6), error)
            blocked = ((q <= low) & (step < 0) | (q >= high) & (step > 0)) & (free > 0)
            if not blocked.any():
                break
            free = np.where(blocked, 0.0, free)
        largest = np.abs(step).max()
        if largest < 1e-9:
            return q, False
        tried = np.minimum(np.maximum(q + step * min(1.0, MOST_STEP / largest), low), high)
        T_tried, J_tried = _forward(origins, axes, slides, tool, tried)
        apart_tried = _apart(T_tried, target)
        if ((apart_tried * scale) ** 2).sum() < cost:
            q, J, apart, damping = tried, J_tried, apart_tried, max(damping / 4, 1e-7)
        else:
            damping *= 4
            if damping > 10.0:
                return q, False
    return q, False


def arm_of(description: Description, base: str, palm: str) -> Arm | str:
    """The arm from `base` to `palm`, or in words why there is none.

    Where the description does not know `base`, as a world around the robot, from its root on.
    """
    chain: list[Joint] = []
    link = palm
    while link != base and link in description.joints:
        joint = description.joints[link]
        if joint.follows != joint.name:
            return f"its joint {joint.name!r} follows another one"
        chain.append(joint)
        link = joint.parent
    if not chain:
        return f"the description has no joint that carries {palm!r}"
    arm = Arm(tuple(reversed(chain)), link)
    return arm if arm.movable else f"nothing moves between {link!r} and {palm!r}"
