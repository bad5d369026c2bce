"""Frames that /tf and the robot description both place: where they contradict each other.

tf2 knows one parent of a frame. A recording may hold a calibrated mount beside a description's
nominal one, a tracker that publishes the camera in a map of its own, or a second publisher that is
late.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgeval.geometry import invert, rotation_angle
from dgeval.recording.transforms import TransformTree
from dgeval.robots.description import Description

# m and rad, in the median, by which two sources of one transform may differ: tf and joint states
# are seldom of one moment; ours
APART_M, APART_RAD = 0.005, 0.06
SAMPLED, LEAST_SAMPLES = 20, 3  # times at which both are compared, and at which both are known


def unplaced_by_tf(
    recorded: TransformTree, described: TransformTree, times: Sequence[int]
) -> dict[str, str]:
    """The frames that /tf hangs on something that nothing ties to the robot, with that parent.

    recorded: transforms alone. described: the description alone, whose states are known at some of
    the times, ns; where they are not, /tf is all that is known.
    """
    links = described.frames()
    out = {}
    for child in sorted(recorded.frames() & links):
        parent = recorded.parent(child)
        if parent is None or described.parent(child) is None:
            continue
        if links & set(recorded.ancestors(parent)):
            continue
        root = described.root(child)
        if any(described.lookup(root, child, t) is not None for t in times):
            out[child] = parent
    return out


def contradictions(
    recorded: TransformTree,
    described: TransformTree,
    description: Description,
    times: Sequence[int],
) -> tuple[list[str], list[str]]:
    """Sentences on mounts that the description has elsewhere, and on frames that move elsewhere.

    A link that moves on the description's own parent is `description_checks`'s matter. times: of
    the joint states, ns.
    """
    links = described.frames()
    mounts, moving = [], []
    for child in sorted(recorded.frames() & links):
        parent = recorded.parent(child)
        if parent not in links or described.parent(child) is None:
            continue
        if child in recorded.static:
            off = _off(described, parent, child, times, recorded)
            if off is not None:
                mounts.append(
                    f"/tf puts {child!r} {off} from where the description has it on {parent!r}: "
                    "/tf counts"
                )
        elif recorded.moving[child][1].has_one_parent and (
            child not in description.joints or description.joints[child].parent != parent
        ):
            off = _off(described, parent, child, recorded.moving[child][1].times, recorded)
            if off is not None:
                moving.append(
                    f"/tf puts {child!r} {off} from where the description and the joint states "
                    f"have it on {parent!r}: one of them is late, or another robot's; /tf counts"
                )
    return mounts, moving


def _off(
    described: TransformTree,
    parent: str,
    child: str,
    times: Sequence[int],
    recorded: TransformTree,
) -> str | None:
    """How far both are apart, in the median; None where they agree or can't be compared."""
    metres, radians = [], []
    for t_ns in times[:: max(1, len(times) // SAMPLED)]:
        T = recorded.lookup(parent, child, t_ns)
        T_described = described.lookup(parent, child, t_ns)
        if T is not None and T_described is not None:
            off = invert(T) @ T_described
            metres.append(float(np.linalg.norm(off[:3, 3])))
            radians.append(rotation_angle(off[:3, :3]))
    if len(metres) < LEAST_SAMPLES:
        return None
    far, turned = float(np.median(metres)), float(np.median(radians))
    if far <= APART_M and turned <= APART_RAD:
        return None
    most = f" (at most {max(metres) * 1000:.0f} mm)" if max(metres) > 1.5 * far else ""
    return f"{far * 1000:.0f} mm{most} and {np.degrees(turned):.0f} degrees"
