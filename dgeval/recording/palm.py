"""Which frame is the palm of the hand that grasps."""

from __future__ import annotations

import numpy as np

from dgeval.config import Config
from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.recording.roles import Roles
from dgeval.recording.scan import Scan
from dgeval.recording.transforms import TransformTree
from dgeval.robots.description import Description

LOOKED_AT = 40  # times of a recording at which the frames are compared
APART_M = 0.10  # m, by which a frame moves in one that is on another hand; ours
CARRIED_M = 0.02  # m, by which a camera that a hand carries moves in its frame at most; ours
MOVES_TIMES = 3.0  # as far as any other, that the hand moves which goes to the target; ours
# words in the name of the frame that stands for the palm, in order of preference
PALM_WORDS = (
    ("palm",),
    ("hand_base", "gripper_base", "base_gripper", "robotiq_arg2f_base", "robotiq_base"),
    ("_hand", "hand_link"),
    ("gripper_link", "gripper"),
    ("tcp",),
    ("tool0", "ee_link", "end_effector", "flange"),
)
# parts of the name of a frame that may carry a camera, and no hand
CARRIES_NO_HAND = ("camera", "optical", "base", "head", "neck", "pan_", "tilt", "torso", "odom")
# parts of the name of a frame that is no palm though it has such a word
NO_PALM = (
    "camera",
    "optical",
    "finger",
    "thumb",
    "knuckle",
    "pad",
    "handle",
    "hand_pose",
    "goal",
    "target",
    "desired",
    "command",
    "grasp",
)


def palm_of(
    scan: Scan,
    roles: Roles,
    config: Config,
    tree: TransformTree,
    camera: str,
    description: Description | None,
    notes: list[str],
) -> tuple[str | None, tuple[str, ...]]:
    """The palm's frame, or the palms of several hands of which nothing tells the one that grasps.

    By the configuration, by its name, where the description's chains of joints part, by a pose
    topic, else the frame that carries the camera. UsageError where the configuration names a frame
    that is not there.
    """
    frames = tree.frames()
    if config.frames.palm is not None:
        if config.frames.palm not in frames:
            raise UsageError(
                f"frames.palm = {config.frames.palm!r} is in neither tf nor the robot description"
            )
        return config.frames.palm, ()
    usable = [f for f in frames if not any(part in f.lower() for part in NO_PALM)]
    ranked = [sorted(f for f in usable if any(w in f.lower() for w in ws)) for ws in PALM_WORDS]
    ranked.append([] if description is None else sorted(description.branches()))
    times: list[int] = []
    if roles.colour in scan.times:
        stamps = scan.times[roles.colour].arrays()[0]
        at = np.unique(np.linspace(0, max(0, len(stamps) - 1), LOOKED_AT).astype(int))
        times = stamps[at].tolist() if len(stamps) else []
    hands = _hands([f for group in ranked for f in group], tree, times)
    if len(hands) > 1:
        kept = _the_one_that_grasps(hands, tree, camera, times, notes)
        if kept is None:
            return None, tuple(hand[0] for hand in hands)
        ranked = [[f for f in group if f in kept] for group in ranked]
    for named in ranked:
        if named:
            return _nearest_to_camera(named, tree, camera, notes), ()
    if roles.hand_pose:
        offset = config.clock.hand_pose.offset_ns
        for pose in scan.poses[roles.hand_pose]:
            tree.add_moving(
                pose.t_ns + offset, pose.parent or "base", "palm (hand_pose)", pose.pose
            )
        return "palm (hand_pose)", ()
    carrier = next((f for f in tree.ancestors(camera)[1:] if f in tree.moving), None)
    if carrier is not None and not any(part in carrier.lower() for part in CARRIES_NO_HAND):
        notes.append(f"palm frame: {carrier!r}, which carries the camera (frames.palm)")
        return carrier, ()
    return None, ()


def _nearest_to_camera(named: list[str], tree: TransformTree, camera: str, notes: list[str]) -> str:
    """Of several frames that may be the palm, the one nearest to the camera in the tree.

    The camera hangs on one arm; a hand on another arm meets it at the base only. Between equals the
    first by name, said in the notes.
    """
    above = tree.ancestors(camera)

    def steps(frame: str) -> int:
        """Edges from the frame up to where the camera's chain begins, and down to the camera."""
        chain = tree.ancestors(frame)
        common = next((f for f in chain if f in above), None)
        return 1000 if common is None else chain.index(common) + above.index(common)

    best = min(named, key=lambda f: (steps(f), f))
    others = [f for f in named if f != best]
    if others:
        equal = [f for f in others if steps(f) == steps(best)]
        why = "the first by name" if equal else "nearest to the camera"
        notes.append(
            f"palm frame: {best!r}, {why}; {', '.join(others)} could be it too (frames.palm)"
        )
    elif "palm" not in best.lower():
        notes.append(f"palm frame: {best!r}, by its name (frames.palm)")
    return best


def _hands(frames: list[str], tree: TransformTree, times: list[int]) -> list[list[str]]:
    """The frames by hand, in the order given: those of one hand nearly keep their places on it."""
    hands: list[list[str]] = []
    for frame in dict.fromkeys(frames):
        mine = next((h for h in hands if _spread(tree, h[0], frame, times) < APART_M), None)
        if mine is None:
            hands.append([frame])
        else:
            mine.append(frame)
    return hands


def _spread(tree: TransformTree, a: str, b: str, times: list[int]) -> float:
    """How far frame b moves in frame a, m; 0 where it is not known."""
    places = [T[:3, 3] for t in times if (T := tree.lookup(a, b, t)) is not None]
    return float(np.linalg.norm(np.ptp(np.array(places), axis=0))) if places else 0.0


def _the_one_that_grasps(
    hands: list[list[str]],
    tree: TransformTree,
    camera: str,
    times: list[int],
    notes: list[str],
) -> list[str] | None:
    """The frames of the hand that carries the camera, else of the one that moves; None where
    neither tells.
    """
    ways = [_way(tree, h[0], times) for h in hands]
    # a hand that stands still keeps its place to a camera that does so too
    carrying = [
        hand
        for hand, way in zip(hands, ways, strict=True)
        if way > CARRIED_M and _spread(tree, hand[0], camera, times) < CARRIED_M
    ]
    others = ", ".join(h[0] for h in hands)
    if len(carrying) == 1:
        notes.append(f"of the hands {others}, {carrying[0][0]!r} carries the camera (frames.palm)")
        return carrying[0]
    order = sorted(range(len(hands)), key=lambda k: ways[k])
    most, next_most = order[-1], order[-2]
    if carrying or ways[most] < MOVES_TIMES * max(ways[next_most], CARRIED_M):
        return None
    notes.append(f"of the hands {others}, {hands[most][0]!r} moves (frames.palm)")
    return hands[most]


def _way(tree: TransformTree, frame: str, times: list[int]) -> float:
    """How far a frame moves, m: the largest extent of its places against the top of its tree."""
    top = tree.root(frame)
    places: list[Array] = [T[:3, 3] for t in times if (T := tree.lookup(top, frame, t)) is not None]
    return float(np.ptp(np.array(places), axis=0).max()) if places else 0.0
