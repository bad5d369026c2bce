"""The fingers of a described hand: where they are, their tips, how they close, where they meet."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dgeval.geometry import Array, invert, transform
from dgeval.robots.description import Description, Joint, LinkShape, crank_beside
from dgeval.robots.hand_links import HandLinks, poses
from dgeval.robots.hand_solids import surface_points

TIP_M = 0.004  # m; what lies so near to the farthest point of a finger is its tip
BEHIND_TIPS_M = 0.010  # m, from the fingertips towards the palm, where held things are; ours
STEPS = 21  # postures from open to closed, at which the fingertips are compared
# shares of the way to a limit, after which the fingertips tell whether it closes; the whole way may
# lead past each other, and a finger that stands straight beside others first goes away from them
SHARES = (0.1, 0.25, 0.5)
NEARER_M = 1e-4  # m, by which the fingertips must come nearer; ours
LEAST_LEVER_M = 0.01
LEAST_CLOSED = 0.02  # share of a joint's range, that a hand which closes moves it by; ours
AHEAD = 0.4  # share of how far open fingertips stand out from the palm; ours
LEAST_WAY_M = 1e-9  # m; points nearer than this are one
BAR = 0.75  # share of the longest finger's reach, that one of one joint has at least; ours


@dataclass(frozen=True)
class HandGeometry:
    """A hand's links with their solids and joints; positions (k,) are in the order of `joints`.

    All places are in the frame of `links.base`. open (k,) rad, m: the positions before a close.
    given: those of the closed hand that a user named, by joint.
    """

    description: Description
    links: HandLinks
    open: Array
    given: tuple[tuple[str, float], ...] = ()

    @cached_property
    def joints(self) -> list[Joint]:
        """Those that move, by finger, each after those above it."""
        return self.links.joints(self.description)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper (k,) rad or m, of the joints; infinite without."""
        return np.array([j.lower for j in self.joints]), np.array([j.upper for j in self.joints])

    @cached_property
    def spans(self) -> Array:
        """(k,) rad or m, the ranges of the joints; 1 where there are no limits."""
        lower, upper = self.limits
        return np.where(np.isfinite(upper - lower), upper - lower, 1.0)

    @cached_property
    def key(self) -> str:
        """Of the fingers' joints: which they are, where, their axes and limits. Other trials of the
        same hand have the same.
        """
        digest = hashlib.sha256()
        for joint in self.joints:
            numbers = [*joint.origin.ravel(), *joint.axis, joint.lower, joint.upper]
            rounded = ",".join(f"{v + 0.0:.5f}" for v in np.round(numbers, 5).tolist())
            digest.update(f"{joint.name} {joint.kind} {rounded}\n".encode())
        return digest.hexdigest()[:16]

    def poses(self, positions: Array) -> dict[str, Array]:
        """By link, T_base_link (4, 4)."""
        named = dict(zip(self.names, positions.tolist(), strict=True))
        return poses(self.description, self.links, named)

    def shapes(self, positions: Array) -> list[tuple[LinkShape, Array]]:
        """The solids of palm and fingers with T_base_shape (4, 4)."""
        listed = self.poses(positions).items()
        of = self.description.shapes
        return [(s, T @ s.T_link_shape) for link, T in listed for s in of.get(link, [])]

    @cached_property
    def palm(self) -> Array:
        """(3,) m, the middle of the solids that the fingers hang on, or the frame's origin."""
        points = [surface_points(s) for s in self.description.shapes.get(self.links.base, [])]
        return np.asarray(np.vstack(points).mean(axis=0)) if points else np.zeros(3)

    @cached_property
    def tips(self) -> tuple[tuple[str, Array], ...]:
        """Of each finger the link that reaches farthest from the palm, and the tip in that link's
        frame (3,) m. A finger that parts has several. A bar of a linkage is no finger: one joint
        moves it, and it reaches much less far than others. A thumb is short too, and has more.
        """
        joints = self.description.joints
        ends = [end for finger in self.links.fingers for end in self._ends(finger)]
        bars = {end for end in ends for link in end if crank_beside(joints, link) is not None}
        found = [(self._tip(end), end) for end in ends if end not in bars]
        most = max(reach for (reach, _, _), _ in found)
        return tuple(
            (link, tip)
            for (reach, link, tip), end in found
            if reach > BAR * most or sum(joints[k].kind != "fixed" for k in end) > 1
        )

    def _ends(self, finger: tuple[str, ...]) -> list[tuple[str, ...]]:
        """For each last joint that moves of a finger, the links from the palm to it and what is
        fixed to them.
        """
        joints = self.description.joints
        moving: dict[str, tuple[str, ...]] = {}  # by link: those from the palm to it that move
        for link in finger:
            above = moving.get(joints[link].parent, ())
            moving[link] = above if joints[link].kind == "fixed" else (*above, link)
        ways = dict.fromkeys(moving.values())
        whole = [w for w in ways if not any(o[: len(w)] == w for o in ways if o != w)]
        return [
            tuple(link for link in finger if moving[link] == w[: len(moving[link])]) for w in whole
        ]

    def _tip(self, finger: tuple[str, ...]) -> tuple[float, str, Array]:
        at = self.poses(self.open)
        best: tuple[float, str, Array] = (-1.0, finger[-1], np.zeros(3))
        for link in finger:
            points = [surface_points(s) for s in self.description.shapes.get(link, [])]
            points.append(np.zeros((1, 3)))  # the frame itself, as of a tip or a pad
            local = np.vstack(points)
            far = np.linalg.norm(transform(at[link], local) - self.palm, axis=1)
            if far.max() > best[0]:
                best = float(far.max()), link, local[far > far.max() - TIP_M].mean(axis=0)
        return best

    def tips_at(self, positions: Array) -> Array:
        """(f, 3) m, the fingertips."""
        T = self.poses(positions)
        return np.array([transform(T[link], tip[None])[0] for link, tip in self.tips])

    @cached_property
    def opposite(self) -> Array:
        """(3,) m, what a hand's only finger closes to: the end of the palm on the finger's side."""
        T = self.poses(self.open)
        listed = [
            transform(T[link], surface_points(shape))
            for link in self.links.palm
            for shape in self.description.shapes.get(link, [])
        ]
        if not listed:
            return np.zeros(3)
        points = np.vstack(listed)
        root = T[self.links.fingers[0][0]][:3, 3]
        along = (points - root) @ (self.tips_at(self.open)[0] - root)
        return np.asarray(points[along >= np.quantile(along, 0.9)].mean(axis=0))

    @cached_property
    def alone(self) -> int:
        """The fingertip that all others close to: the farthest from them, as a thumb's."""
        tips = self.tips_at(self.open)
        return int(np.argmax([np.linalg.norm(tips - p, axis=1).sum() for p in tips]))

    def apart(self, positions: Array) -> float:
        """m, how far the fingertips are from the one that they close to; an only one, from the
        palm's side.
        """
        tips = self.tips_at(positions)
        if len(tips) == 1:
            return float(np.linalg.norm(tips[0] - self.opposite))
        others = np.delete(tips, self.alone, axis=0)
        return float(np.linalg.norm(others - tips[self.alone], axis=1).mean())

    @cached_property
    def closed(self) -> Array:
        """(k,) the positions at the limits in the direction that brings the fingertips together.

        Joints that follow others go with them; one without limits, or that brings nothing
        together, stays where it is. A position that is given goes before.
        """
        closed, start = self.open.copy(), self.apart(self.open)
        given = dict(self.given)
        for k, joint in enumerate(self.joints):
            if joint.follows != joint.name and joint.follows in self.names:
                continue
            if joint.name in given:
                closed = self._followed(closed, k, given[joint.name])
                continue
            best = start - NEARER_M
            for limit in (joint.lower, joint.upper):
                if not np.isfinite(limit):
                    continue
                way = [self.open[k] + share * (limit - self.open[k]) for share in SHARES]
                apart = min(self.apart(self._followed(self.open, k, at)) for at in way)
                if apart < best:
                    best, closed = apart, self._followed(closed, k, limit)
        return closed

    @cached_property
    def closes(self) -> bool:
        """Whether the closed positions differ from the open ones at all."""
        return bool((np.abs(self.closed - self.open) > LEAST_CLOSED * self.spans).any())

    def _followed(self, positions: Array, k: int, value: float) -> Array:
        """The positions with one joint at another place, and those that follow it."""
        out = positions.copy()
        out[k] = value
        for i, joint in enumerate(self.joints):
            if i != k and joint.follows == self.joints[k].name:
                out[i] = joint.multiplier * value + joint.offset
        return out

    def meeting(self, closed: Array) -> Array:
        """(3,) m, where the fingertips meet on the way to closed positions (k,), a little towards
        the palm.

        Between the finger that stands alone and all others: a thumb is as good as four fingers. A
        hand whose limits let it fold through its palm meets before that.
        """
        way = closed - self.open
        on = [self.open + share * way for share in np.linspace(0.0, 1.0, STEPS)]
        on = list(itertools.takewhile(self._ahead_of_palm, on))
        nearest = min(on, key=self.apart)
        tips = self.tips_at(nearest)
        if len(tips) == 1:
            middle = (tips[0] + self.opposite) / 2
        else:
            middle = (tips[self.alone] + np.delete(tips, self.alone, axis=0).mean(axis=0)) / 2
        away = middle - self.palm
        length = float(np.linalg.norm(away))
        return np.asarray(middle - away / max(length, 1e-9) * min(BEHIND_TIPS_M, length))

    def _ahead_of_palm(self, positions: Array) -> bool:
        """Whether the fingertips still stand out from the palm, by a share of what they do open; of
        those that do open.
        """
        opened = self.tips_at(self.open) - self.palm
        front = opened.mean(axis=0)
        out = opened @ front > 0
        now = (self.tips_at(positions) - self.palm) @ front
        return bool((now >= AHEAD * (opened @ front))[out].all())

    def ahead(self, centre: Array) -> Array:
        """(3,) unit vector from the palm to the grasp's centre (3,) m; of two fingertips across the
        way that they close. The base's z where they are one point.
        """
        way = centre - self.palm
        tips = self.tips_at(self.open)
        if len(tips) == 2:
            closing = tips[1] - tips[0]
            closing = closing / max(float(np.linalg.norm(closing)), LEAST_WAY_M)
            way = way - closing * (closing @ way)
        length = float(np.linalg.norm(way))
        return way / length if length > LEAST_WAY_M else np.array([0.0, 0.0, 1.0])

    @cached_property
    def levers(self) -> Array:
        """(k,) of the joints."""
        return np.array([self.lever(joint) for joint in self.joints])

    def lever(self, joint: Joint) -> float:
        """m, from a joint's axis to its finger's tip; 1 for one that slides, whose force it is."""
        if joint.kind == "prismatic":
            return 1.0
        finger = next(finger for finger in self.links.fingers if joint.child in finger)
        _, link, tip = self._tip(finger)
        T = self.poses(self.open)
        place = transform(invert(T[joint.child]) @ T[link], tip[None])[0]
        return max(float(np.linalg.norm(np.cross(joint.axis, place))), LEAST_LEVER_M)
