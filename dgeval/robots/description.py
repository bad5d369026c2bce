"""A robot as it describes itself: joints for the tf tree, and its links' solids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from dgeval.geometry import IDENTITY, Array, rotation_about

Kind = Literal["box", "capsule", "cylinder", "sphere", "hull"]

# By joint: the joint that it follows, which follows no other, the factor and the offset.
Coupling = dict[str, tuple[str, float, float]]

BESIDE = 0.5  # of a crank's length; a bar of its linkage hangs nearer beside it; ours
PARALLEL = 0.99  # cosine between the axes of a crank and its bar; ours


@dataclass(frozen=True, slots=True)
class LinkShape:
    """One solid of a link.

    size, m: box half lengths; capsule, cylinder (radius, half length along z); sphere (radius,).
    hull: planes of a mesh's convex hull, rows n_x n_y n_z d with n·p + d <= 0 inside. corners
    (n, 3) m: of the hull. mesh: its vertices (m, 3) m and faces (k, 3). bound, m: no point of the
    solid is further from the shape's origin. rough: it stands for something of another shape.
    """

    link: str
    kind: Kind
    T_link_shape: Array
    size: tuple[float, ...] = ()
    hull: Array | None = None
    bound: float = 0.0
    corners: Array | None = None
    mesh: tuple[Array, Array] | None = None
    rough: bool = False


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint.

    T_parent_child = origin · motion(q · multiplier + offset), with q the position of the joint that
    it follows, which follows no other. Limits in rad or m; effort in Nm or N.
    """

    name: str
    parent: str
    child: str
    kind: Literal["revolute", "prismatic", "fixed"]
    origin: Array
    axis: Array
    follows: str
    multiplier: float
    offset: float
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf

    def at(self, q: float) -> Array:
        """T_parent_child (4, 4) at joint position q, rad or m, of the joint it follows."""
        return self.moved(self.multiplier * q + self.offset)

    def moved(self, value: float) -> Array:
        """T_parent_child (4, 4) at its own position, rad or m."""
        if self.kind == "fixed":
            return self.origin.copy()
        T = IDENTITY.copy()
        if self.kind == "revolute":
            T[:3, :3] = rotation_about(self.axis, value)
        else:
            T[:3, 3] = self.axis * value
        return np.asarray(self.origin @ T)


@dataclass(frozen=True)
class Description:
    """Joints by child link, shapes by link, and notes on what the description does not give.

    mass_centres: by link, its centre of mass (3,) m in the link's frame, where one is given.
    radius m: of capsules that stand in for solids. outlines: by link whose shapes are rough, what
    is seen of it, where its meshes are there.
    """

    joints: dict[str, Joint]
    shapes: dict[str, list[LinkShape]]
    notes: list[str] = field(default_factory=list)
    mass_centres: dict[str, Array] = field(default_factory=dict)
    radius: float = 0.01
    outlines: dict[str, list[LinkShape]] = field(default_factory=dict)

    def with_prefix(self, prefix: str) -> Description:
        """The same with a prefix before the name of each link; joints keep theirs."""

        def solids(listed: list[LinkShape]) -> list[LinkShape]:
            return [replace(s, link=prefix + s.link) for s in listed]

        joints = {
            prefix + child: replace(j, parent=prefix + j.parent, child=prefix + j.child)
            for child, j in self.joints.items()
        }
        return replace(
            self,
            joints=joints,
            shapes={prefix + link: solids(listed) for link, listed in self.shapes.items()},
            mass_centres={prefix + link: at for link, at in self.mass_centres.items()},
            outlines={prefix + link: solids(listed) for link, listed in self.outlines.items()},
        )

    def partings(self) -> list[str]:
        """The links at which two or more chains of movable joints part, in name order."""
        children: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)

        def moves(joint: Joint) -> bool:
            return joint.kind != "fixed" or any(moves(j) for j in children.get(joint.child, []))

        return sorted(link for link, listed in children.items() if sum(map(moves, listed)) >= 2)

    def branches(self) -> list[str]:
        """The deepest of the partings: the bases of hands. One of two arms has others below it."""
        return self.deepest(self.partings())

    def deepest(self, links: list[str]) -> list[str]:
        """Those of some links that have none of them below."""
        return [link for link in links if not set(links) & set(self.below(link)) - {link}]

    def below(self, link: str) -> list[str]:
        """The link and all links that hang from it, in name order."""
        out = {link}
        while True:
            more = {j.child for j in self.joints.values() if j.parent in out} - out
            if not more:
                return sorted(out)
            out |= more


def resolved(names: list[str], direct: Coupling, notes: list[str]) -> Coupling:
    """What each joint follows, chains resolved; a joint that follows none follows itself.

    direct: of those that follow another. notes get what follows itself.
    """
    out: Coupling = {}
    for name in names:
        source, multiplier, offset = name, 1.0, 0.0
        for _ in names:
            if source not in direct:
                break
            source, factor, added = direct[source]
            multiplier, offset = multiplier * factor, offset + multiplier * added
        if source in direct:
            notes.append(f"joint {name} follows itself in a circle, and is taken as free")
            source, multiplier, offset = name, 1.0, 0.0
        out[name] = source, multiplier, offset
    return out


def crank_beside(joints: Mapping[str, Joint], link: str) -> Array | None:
    """The crank that a bar of a linkage runs along, (3,) m in the bar's frame where no joint has
    moved; None for a link that is no such bar.

    A gripper whose pads stay parallel has one on each side. In a tree the bar is a link without
    a joint below, which hangs close beside another on the same link, about the same axis, and moves
    only as that one does: from that one's joint to the next on its finger it is as long.
    """
    own = joints.get(link)
    if own is None or own.kind != "revolute" or _next_joints(joints, link):
        return None
    for other in sorted(joints):
        joint = joints[other]
        coupled = joint.follows == own.follows and other != link and joint.parent == own.parent
        if not coupled or joint.kind != "revolute":
            continue
        ahead = _next_joints(joints, other)
        apart = float(np.linalg.norm(joint.origin[:3, 3] - own.origin[:3, 3]))
        axis, axis_other = own.origin[:3, :3] @ own.axis, joint.origin[:3, :3] @ joint.axis
        near = len(ahead) == 1 and apart < BESIDE * float(np.linalg.norm(ahead[0]))
        if near and abs(float(axis @ axis_other)) > PARALLEL:
            return np.asarray(own.origin[:3, :3].T @ joint.origin[:3, :3] @ ahead[0])
    return None


def _next_joints(joints: Mapping[str, Joint], link: str) -> list[Array]:
    """(3,) m each, link frame: where the next joints that move hang, on the link or on links that
    are fixed to it.
    """
    T_by_link = {link: IDENTITY}
    found: list[Array] = []
    fixed = [link]
    for above in fixed:
        for child in sorted(c for c, joint in joints.items() if joint.parent == above):
            T_by_link[child] = T_by_link[above] @ joints[child].origin
            if joints[child].kind == "fixed":
                fixed.append(child)
            else:
                found.append(T_by_link[child][:3, 3])
    return found
