"""Which links of a description are the hand: the fingers that part from the palm.

Structure decides: the palm is all that is fixed to the palm's frame, and a finger is what hangs on
it by a joint that moves.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from dgeval.geometry import IDENTITY, Array, invert
from dgeval.robots.description import Description, Joint

# m, that fingers reach at most from their first joint; what reaches farther is an arm; ours
LONGEST_FINGER_M = 0.35
MOST_NAMED = 6  # joints that a sentence lists


@dataclass(frozen=True)
class HandLinks:
    """The links of a hand, by name.

    base: that of the palm's in whose frame the others are given. palm: all that are fixed to it,
    the topmost first. fingers: for each chain that hangs on the palm, its links from the first that
    moves on.
    """

    base: str
    palm: tuple[str, ...]
    fingers: tuple[tuple[str, ...], ...]

    def joints(self, description: Description) -> list[Joint]:
        """The joints that move, by finger, each after those above it."""
        listed = (description.joints[link] for finger in self.fingers for link in finger)
        return [joint for joint in listed if joint.kind != "fixed"]


def hand_links(description: Description, palm: str, recorded: Collection[str]) -> HandLinks | str:
    """The hand that has a palm's frame, or in words why there is none whose posture is known.

    recorded: names of the joints whose positions are known.
    """
    group = _fixed_group(description, palm)
    chains = _chains(description, group)
    if not chains:
        what = f"the description has no hand that moves on {palm!r}"
        above = description.joints.get(palm)
        if above is None or above.kind == "fixed":
            return what
        return f"{what}; if that is a jaw itself: --set frames.palm={above.parent}"
    # beyond the wrist, or on one of several arms: what reaches far is no finger
    long = tuple(c for c in chains if _reach(description, c) > LONGEST_FINGER_M)
    arms = chains if len(chains) == 1 else long
    deeper = [b for b in description.partings() if any(b in arm for arm in arms)]
    own = description.deepest([b for b in deeper if _drives_itself(description, b)])
    if len(own) > 1:
        return f"the hand could hang on {' or '.join(own)}: name its palm (frames.palm)"
    if own:
        group = _fixed_group(description, own[0])
        chains = _chains(description, group)
    base = description.joints[chains[0][0]].parent
    found = HandLinks(base, group, chains)
    reach = max(_reach(description, chain) for chain in chains)
    if reach > LONGEST_FINGER_M:
        return (
            f"what moves on {palm!r} reaches {reach:.2f} m, which no finger does: name the hand's "
            "palm (frames.palm)"
        )
    return _unknown_posture(found, description, recorded) or found


def _fixed_group(description: Description, link: str) -> tuple[str, ...]:
    """All links that are fixed to one, its topmost first, the others in name order."""
    top = link
    while top in description.joints and description.joints[top].kind == "fixed":
        top = description.joints[top].parent
    out = {top}
    while True:
        more = {
            child
            for child, joint in description.joints.items()
            if joint.parent in out and joint.kind == "fixed"
        } - out
        if not more:
            return (top, *sorted(out - {top}))
        out |= more


def _chains(description: Description, group: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """What hangs on a group by joints that move, by name: links, each after the one above it."""
    first = sorted(
        child
        for child, joint in description.joints.items()
        if joint.parent in group and joint.kind != "fixed"
    )
    return tuple(_downwards(description, link) for link in first)


def _downwards(description: Description, link: str) -> tuple[str, ...]:
    """A link and all below it, each after the one above it."""
    out = [link]
    for above in out:
        out += sorted(c for c, joint in description.joints.items() if joint.parent == above)
    return tuple(out)


def _drives_itself(description: Description, branch: str) -> bool:
    """Whether a joint below a link follows none above it, as in a finger that is a linkage."""
    below = set(description.below(branch)) - {branch}
    own = [description.joints[link] for link in below]
    names = {joint.name for joint in own}
    return any(joint.kind != "fixed" and joint.follows in names for joint in own)


def _reach(description: Description, chain: tuple[str, ...]) -> float:
    """m, of the chain's farthest link from its first joint, stretched out."""
    length = {chain[0]: 0.0}
    for link in chain[1:]:
        joint = description.joints[link]
        length[link] = length[joint.parent] + float(np.linalg.norm(joint.origin[:3, 3]))
    return max(length.values())


def _unknown_posture(found: HandLinks, description: Description, recorded: Collection[str]) -> str:
    """Why the posture of the fingers is not known; "" where it is, and can be used."""
    joints = found.joints(description)
    free = sorted(j.name for j in joints if j.name not in recorded and j.follows not in recorded)
    if free:
        named = ", ".join(free[:MOST_NAMED]) + (", …" if len(free) > MOST_NAMED else "")
        return f"the fingers' posture is not recorded: no positions of {named}"
    for joint in joints:
        if joint.lower > joint.upper:
            return f"the limits of {joint.name} are upside down ({joint.lower:g}, {joint.upper:g})"
    return ""


def poses(
    description: Description, found: HandLinks, positions: dict[str, float]
) -> dict[str, Array]:
    """By link, T_base_link (4, 4) at joint positions, rad or m, by the joints' names."""
    top = found.palm[0]
    T_top: dict[str, Array] = {top: IDENTITY.copy()}
    for link in _downwards(description, top)[1:]:
        joint = description.joints[link]
        if joint.parent in T_top:
            T_top[link] = T_top[joint.parent] @ joint.moved(positions.get(joint.name, 0.0))
    T_base_top = invert(T_top[found.base])
    wanted = (*found.palm, *(link for finger in found.fingers for link in finger))
    return {link: T_base_top @ T_top[link] for link in wanted}
