"""Joint states and frames whose names have a prefix that the description lacks, or, of joints, the
other way round.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

from dgeval.recording.messages import JointSample
from dgeval.robots.description import Description

MARKS = "/_.:-"  # that end a prefix
LEAST = 2  # joints that must share it, where the description has more than one


def as_described(
    samples: Sequence[JointSample], description: Description
) -> tuple[list[JointSample], str]:
    """The samples under the description's names, and a note; as they are, and "", where no single
    prefix says which joint is which.
    """
    recorded = {name for s in samples for name in s.positions}
    own = {j.name for j in description.joints.values() if j.kind != "fixed"}
    other, missing = recorded - own, own - recorded
    more, less = _one_prefix(other, missing), _one_prefix(missing, other)
    one = more or less
    if one is None or (more is not None and less is not None):
        return list(samples), ""
    prefix, cut = one
    if len(cut) < min(LEAST, len(missing)):
        return list(samples), ""
    names = {prefix + name: name for name in cut} if more else {n: prefix + n for n in cut}
    renamed = [
        replace(s, positions=_renamed(s.positions, names), efforts=_renamed(s.efforts, names))
        for s in samples
    ]
    which = "the joint states" if more else "the description"
    others = "the description" if more else "the joint states"
    return renamed, f"{which} have joints called {prefix}…, {others} the same without: taken as one"


def as_published(description: Description, frames: Collection[str]) -> tuple[Description, str]:
    """The description with its links named as the frames of /tf and of the images, and a note; as
    it is, and "", where no single prefix says which link is which.

    A robot_state_publisher with a frame_prefix leaves the description's text as it is. A single
    frame, that of the images where there is no /tf, is enough for a prefix that ends with a slash;
    another may be a second camera's.
    """
    links = {name for j in description.joints.values() for name in (j.parent, j.child)}
    one = _one_prefix(set(frames) - links, links - set(frames))
    least = 1 if one is not None and len(frames) == 1 and one[0].endswith("/") else LEAST
    if one is None or len(one[1]) < max(least, len(links & set(frames)) + 1):
        return description, ""
    prefix = one[0]
    return description.with_prefix(prefix), (
        f"the recorded frames are called {prefix}…, the description's links the same without: "
        "taken as one"
    )


def _one_prefix(longer: Iterable[str], shorter: Iterable[str]) -> tuple[str, list[str]] | None:
    """The prefix, which ends with a mark, that makes longer names of the most shorter ones, and
    these; none where a longer name has another prefix.
    """
    found: dict[str, list[str]] = {}
    for short in sorted(shorter):
        for long in sorted(longer):
            prefix = long.removesuffix(short)
            if prefix != long and prefix.endswith(tuple(MARKS)):
                found.setdefault(prefix, []).append(short)
    if not found:
        return None
    best = max(sorted(found), key=lambda prefix: len(found[prefix]))
    longs = {prefix + short for prefix, listed in found.items() for short in listed}
    return (best, found[best]) if len(longs) == len(found[best]) else None


def _renamed(values: dict[str, float], names: dict[str, str]) -> dict[str, float]:
    return {names.get(name, name): value for name, value in values.items()}
