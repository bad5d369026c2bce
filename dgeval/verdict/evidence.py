"""What a verdict rests on: the recorded hand, the close, and the object as hindsight sees it.

Nothing here reads the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgeval.failure_rule import Unknown
from dgeval.geometry import Array, invert, rotation_vector, transform
from dgeval.hindsight.second_pass import Hindsight
from dgeval.robots.described_hand import DescribedHand
from dgeval.robots.description import Joint
from dgeval.robots.hand import Hand
from dgeval.verdict.beliefs import Beliefs, beliefs_of
from dgeval.verdict.described_grip import described_grip
from dgeval.verdict.log import Recorded, TrialLog
from dgeval.verdict.recorded_closing import (
    LONGEST_S,
    REST_TICKS,
    Closing,
    closing_as,
    recorded_closing,
)
from dgeval.verdict.recorded_force import recorded_force
from dgeval.verdict.recorded_lift import LOOK_S, recorded_lift
from dgeval.worlds.closing import CONTROL_S, Finish

PERIOD_NS = round(CONTROL_S * 1e9)
AT_END_NS = 500_000_000  # over which efforts at the end are judged, as for the outcome
APPROACH_S = 12.0  # before the close, as much of the approach as is looked at
MIN_REGISTERED = 5  # frames; its shape and path are guesses with fewer
HELD_ABOVE_M = 0.03  # of the lowest point over the support: what is higher does not stand on it
# of a command that still holds; of the hand's motion without commands
COMMAND_AGE_NS, MEASURED_TICKS = 50_000_000, 5
RISES_M = 0.007  # a trembling hand moves by 10 mm and more; registration wobbles by 1 to 3 mm
NO_SUPPORT_M = 0.25  # from the lowest point down to where a support is put when none was seen


@dataclass(frozen=True)
class HandMotion:
    """The recorded hand at even times, n ticks of PERIOD_NS.

    t_ns (n,). T_support_hand (n, 4, 4): hand base in the support frame, whose z points up from the
    surface that the object stands on (z = 0) and whose y lies along its motion. fingers (n, k) rad
    or m: the drives' joint positions. velocity (n, 3) m/s: what the hand would follow with if it
    closed then: the robot's belief where it is recorded, else the object's velocity. going (6,)
    m/s, rad/s: twist of the hand's base with which it would have gone on instead of closing: as
    commanded last, else as measured. closing (m, k): the drives' positions at the ticks from the
    close to the lift, as far as recorded. finish: how the hand followed and lifted after the close;
    None where the log doesn't hold the whole of a lift.
    """

    t_ns: NDArray[np.int64]
    T_support_hand: Array
    fingers: Array
    velocity: Array
    going: Array
    closing: Array
    finish: Finish | None = None


@dataclass(frozen=True)
class Scene:
    """One approach in the support frame. Reference: the close, or the last tick if it never came.

    points (m, 3) m: the object at the reference. free (n, 3) m: its undisturbed displacement from
    there, by tick. velocity (3,) m/s: of the undisturbed object at the reference. sd_m, sd_deg:
    standard deviations of its place and turn at the close, or when the hand was nearest if it never
    came. last_seen: tick at which the undisturbed object was last seen. close: tick of the close
    command. seen (n, 4, 4): by tick, the motion from the reference to where the object was seen,
    NaN where it was not. gripper: the recorded hand. beliefs: the robot's at the reference. held: a
    person holds the object in the air and lets go when it is gripped. closing: of a described hand,
    as recorded.
    """

    hand: HandMotion
    points: Array
    free: Array
    velocity: Array
    sd_m: float
    sd_deg: float
    last_seen: int
    close: int | None
    seen: Array
    gripper: Hand
    beliefs: Beliefs | Unknown
    held: bool = False
    closing: Closing | None = None

    def unseen_s(self, tick: int) -> float:
        """Time at a tick since the undisturbed object was last seen, s; 0 before."""
        return max(0, tick - self.last_seen) * CONTROL_S

    @property
    def reference(self) -> int:
        """The tick at which `points` are given."""
        return len(self.hand.t_ns) - 1 if self.close is None else self.close


def scene_of(log: TrialLog, hindsight: Hindsight) -> Scene | Unknown:
    """The approach up to the close, or to the end of the log without one.

    `Unknown` says why there can't be one.
    """
    close_ns, end_ns, robot = log.close_ns, log.end_ns, log.robot
    description = robot.description
    base = robot.base_frame
    gripper = robot.hand_found
    if description is None or isinstance(gripper, str):
        return Unknown(str(gripper))
    if base is None:
        return Unknown("no pose of the camera in a base frame: the hand's way is not known")
    if hindsight.n_registered < MIN_REGISTERED:
        return Unknown(
            f"the object was registered in only {hindsight.n_registered} frames before the close"
        )
    by_name = {joint.name: joint for joint in description.joints.values()}
    drives = [by_name[name] for name in gripper.drives]
    root = drives[0].parent
    start_ns = max(log.first_ns, end_ns - round(APPROACH_S * 1e9))
    count = (end_ns - start_ns) // PERIOD_NS
    times = end_ns - np.arange(count, -1, -1, dtype=np.int64) * PERIOD_NS
    T_support_base = _support_frame(hindsight, end_ns)
    points = transform(T_support_base @ hindsight.path.at(end_ns), hindsight.points)
    above = hindsight.support is None or float(np.quantile(points[:, 2], 0.02)) > HELD_ABOVE_M
    held = above and _rises(hindsight, T_support_base, end_ns)
    if not held:  # it stands, and neither rises nor sinks while it is not seen
        points[:, 2] -= _risen_unseen(hindsight, T_support_base, end_ns)
    if hindsight.support is None and not held:
        return Unknown("what the object stands on was never seen")
    if not held and (deep := -float(np.median(points[:, 2]))) > 0.0:
        return Unknown(
            f"the object is seen {deep * 1000:.0f} mm below what was taken for its support; is the "
            "target another thing (--bbox)?"
        )
    believed = log.recorded.velocities
    believed_ns = np.array([t for t, _ in believed], dtype=np.int64)
    free = T_support_base[:3, :3] @ hindsight.path.velocity[-1]
    free[2] *= held
    kept: list[int] = []
    poses, fingers, velocities = [], [], []
    for t_ns in times.tolist():
        T = robot.tree.lookup(base, root, t_ns)
        q = [robot.joints.position(joint, t_ns, log.max_gap_ns) for joint in drives]
        if T is None or any(v is None for v in q):
            if kept:
                return Unknown(
                    f"the hand's pose is not known {(end_ns - t_ns) * 1e-9:.2f} s before the end "
                    "of the approach"
                )
            continue
        kept.append(t_ns)
        poses.append(T_support_base @ T)
        fingers.append(q)
        k = int(np.searchsorted(believed_ns, t_ns, side="right")) - 1
        velocities.append(T_support_base[:3, :3] @ believed[k][1][:3] if k >= 0 else free)
    if len(kept) < 20:
        return Unknown("less than 0.2 s of the approach has a known hand pose")
    centres = np.array(
        [transform(hindsight.path.at(t), hindsight.path.centroid[None])[0] for t in kept]
    )
    nearest = -1
    if close_ns is None:
        # without a close its place must be known when the hand was at it, not at the log's end
        palms = np.array([T @ np.append(gripper.centre, 1.0) for T in poses])[:, :3]
        nearest = int(np.argmin(np.linalg.norm(palms - transform(T_support_base, centres), axis=1)))
    moved = (centres - centres[-1]) @ T_support_base[:3, :3].T
    moved[:, 2] *= held
    closing: list[list[float | None]] = []
    longest_s = LONGEST_S if isinstance(gripper, DescribedHand) else gripper.lift_after_s
    while close_ns is not None and len(closing) < round(longest_s / CONTROL_S):
        t_ns = end_ns + (len(closing) + 1) * PERIOD_NS
        row = [robot.joints.position(joint, t_ns, log.max_gap_ns) for joint in drives]
        if any(v is None for v in row):
            break
        closing.append(row)
    way = np.array(closing, dtype=float).reshape(-1, len(drives))
    finish = None if close_ns is None else _finish(log, base, root, T_support_base)
    closed = None
    if isinstance(gripper, DescribedHand):
        near = transform(invert(poses[-1]), points)
        before = np.array(fingers[-1], dtype=float)
        empty = _empty(log, gripper, drives, finish)
        closed = recorded_closing(gripper, before, way, near, empty)
        if closed is not None:
            gripper = closing_as(gripper, closed, "recorded")
        elif log.elsewhere.closing is not None:
            gripper = closing_as(gripper, log.elsewhere.closing, "estimates")
        elif gripper.closing_source == "limits" and not gripper.geometry.closes:
            return Unknown(
                "how the hand closes is not known: no limit of its joints brings its fingertips "
                "together from where they stand; name the closed joints (hand.closed)"
            )
        if close_ns is not None:
            force = recorded_force(gripper, list(log.hand_samples), close_ns, log.last_ns)
            gripper = replace(gripper, force_n=force or gripper.force_n)
        way = way[: round(gripper.lift_after_s / CONTROL_S)]
    hand = HandMotion(
        np.array(kept, dtype=np.int64),
        np.array(poses),
        np.array(fingers, dtype=float),
        np.array(velocities),
        _going(log.recorded, gripper, np.array(poses), T_support_base, end_ns),
        way,
        finish,
    )
    beliefs = beliefs_of(log, hindsight)
    return Scene(
        hand,
        points,
        moved,
        free,
        hindsight.path.sd_at(kept[nearest]),
        float(np.degrees(hindsight.path.sd_angle)),
        int(np.searchsorted(hand.t_ns, hindsight.path.t_ns[-1])),
        None if close_ns is None else len(kept) - 1,
        _seen(hindsight, T_support_base, hand.t_ns, end_ns),
        gripper,
        beliefs if isinstance(beliefs, Unknown) else beliefs.moved(T_support_base),
        held,
        closed,
    )


def _finish(log: TrialLog, base: str, root: str, T_support_base: Array) -> Finish | None:
    """The hand's motion after the close up to the end of its lift."""
    poses = []
    for k in range(round(LOOK_S / CONTROL_S) + 1):
        t_ns = log.end_ns + k * PERIOD_NS
        T = log.robot.tree.lookup(base, root, t_ns) if t_ns <= log.last_ns else None
        if T is None:
            break
        poses.append(T_support_base @ T)
    return recorded_lift(np.array(poses)) if poses else None


def _empty(
    log: TrialLog, hand: DescribedHand, drives: list[Joint], finish: Finish | None
) -> Array | None:
    """Where the joints of a hand (k,) rest after the lift of a grasp that failed: empty, as what is
    between fingers is lifted. None where the log does not hold that, or its fingers press on
    something, whatever an operator says.
    """
    if finish is None or log.close_ns is None:
        return None
    lifted_ns = log.close_ns + len(finish.twists) * PERIOD_NS
    end_ns = min([log.last_ns, *([] if log.released_ns is None else [log.released_ns])])
    times = range(end_ns - REST_TICKS * PERIOD_NS, end_ns, PERIOD_NS)
    if times.start < lifted_ns:
        return None
    samples = list(log.hand_samples)
    end = [s for s in samples if end_ns - AT_END_NS <= s.t_ns <= end_ns]
    grip = described_grip(hand, samples, log.close_ns, end, log.elsewhere.empty)
    if grip is not None and grip[0]:
        return None
    joints = log.robot.joints
    rows = [[joints.position(j, t, log.max_gap_ns) for j in drives] for t in times]
    if any(v is None for row in rows for v in row):
        return None
    return np.asarray(np.median(np.array(rows, dtype=float), axis=0))


def _risen_unseen(hindsight: Hindsight, T_support_base: Array, end_ns: int) -> float:
    """How far the path leads up, m, from where the object was last seen on it to a time."""
    path = hindsight.path
    last_ns = min(int(path.t_ns[-1]), end_ns)
    moved = path.at(end_ns)[:3, 3] - path.at(last_ns)[:3, 3]
    return float((T_support_base[:3, :3] @ moved)[2])


def _rises(hindsight: Hindsight, T_support_base: Array, end_ns: int) -> bool:
    """Whether the object went up or down before the hand came to it, as only what someone holds
    does: what is pushed may topple.

    That nothing was seen of it near its support says little: of a tall box a camera above sees the
    top alone.
    """
    centre = hindsight.path.centroid[None]
    met = [t for t in (hindsight.contact_ns, hindsight.pushed_ns) if t is not None]
    until = min([*met, end_ns])
    seen = [s for s in hindsight.sightings if s.t_ns <= until and s.by == "registration"]
    heights = [transform(T_support_base @ s.T_base_model, centre)[0, 2] for s in seen]
    return (
        len(seen) >= MIN_REGISTERED
        and float(np.subtract(*np.quantile(heights, [0.95, 0.05]))) > RISES_M
    )


def _going(
    recorded: Recorded, gripper: Hand, hands: Array, T_support_base: Array, end_ns: int
) -> Array:
    """Twist (6,) of the hand's frame at the end of the approach, support axes."""
    commands = [v for t, v in recorded.commands if end_ns - COMMAND_AGE_NS <= t <= end_ns]
    if not commands:
        ticks = min(MEASURED_TICKS, len(hands) - 1)
        before, last = hands[-1 - ticks], hands[-1]
        dt = ticks * CONTROL_S
        turn = rotation_vector(last[:3, :3] @ before[:3, :3].T)
        return np.concatenate([last[:3, 3] - before[:3, 3], turn]) / dt
    R = T_support_base[:3, :3]
    return of_hand(
        np.concatenate([R @ commands[-1][:3], R @ commands[-1][3:]]), hands[-1], gripper.T_hand_palm
    )


def of_hand(twist: Array, T_hand: Array, T_hand_palm: Array) -> Array:
    """Twist (6,) of the hand's origin from that of the palm's, in the axes both are given in."""
    lever = -T_hand[:3, :3] @ T_hand_palm[:3, 3]
    return np.concatenate([twist[:3] + np.cross(twist[3:], lever), twist[3:]])


def _support_frame(hindsight: Hindsight, t_ns: int) -> Array:
    """T_support_base (4, 4): z along the support's normal from its surface, y along the motion.

    At rest y is the base frame's, projected. Without a support z is the base frame's, and a surface
    is put NO_SUPPORT_M below the object.
    """
    points = transform(hindsight.path.at(t_ns), hindsight.points)
    n, d = np.array([0.0, 0.0, 1.0]), NO_SUPPORT_M - float(points[:, 2].min())
    if hindsight.support is not None:
        n, d = hindsight.support.n, hindsight.support.d
    v = hindsight.path.velocity[-1]
    along = v - n * (n @ v)
    if np.linalg.norm(along) < 0.005:
        along = np.array([0.0, 1.0, 0.0]) - n * n[1]
    y = along / np.linalg.norm(along)
    R = np.stack([np.cross(y, n), y, n])
    centre = points.mean(axis=0)
    foot = centre - n * (n @ centre + d)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ foot
    return T


def _seen(
    hindsight: Hindsight, T_support_base: Array, t_ns: NDArray[np.int64], end_ns: int
) -> Array:
    """Sightings at the ticks nearest to them; one that its neighbours contradict is left out."""
    out = np.full((len(t_ns), 4, 4), np.nan)
    T_reference = T_support_base @ hindsight.path.at(end_ns)
    at = [s for s in hindsight.sightings if t_ns[0] <= s.t_ns <= t_ns[-1]]
    for before, s, after in zip([at[0], *at], at, [*at[1:], at[-1]], strict=False) if at else []:
        places = [
            transform(x.T_base_model @ invert(hindsight.path.at(x.t_ns)), np.zeros((1, 3)))[0]
            for x in (before, s, after)
        ]
        typical = places[int(np.argsort([np.linalg.norm(p) for p in places])[1])]
        if np.linalg.norm(places[1] - typical) > 0.02:
            continue
        out[int(np.argmin(np.abs(t_ns - s.t_ns)))] = (
            T_support_base @ s.T_base_model @ invert(T_reference)
        )
    return out
