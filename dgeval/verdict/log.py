"""What a verdict reads of a trial's recording, apart from hindsight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array
from dgeval.recording.check import PART_CHECK
from dgeval.recording.closes import gripper_tracks
from dgeval.recording.closing_motion import fingers_seen, release_after
from dgeval.recording.containers.container import Opened
from dgeval.recording.contract import (
    CLOSE_EVENT,
    COMMAND_TOPIC,
    GRASP_TOPIC,
    LIFT_EVENT,
    MASK_TOPIC,
    MODEL_TOPIC,
    TARGET_TOPIC,
    TRIAL_END_EVENT,
    VELOCITY_TOPIC,
)
from dgeval.recording.messages import JointSample, StampedPose, cloud_points
from dgeval.recording.robot import RobotStates
from dgeval.recording.trials import Trial
from dgeval.replay.replayed import Replayed
from dgeval.verdict.recorded_closing import Closing

GOES_ON_NS = 500_000_000  # ns of images after a trial; ours
LAST_NS, MOVES_M_S = (
    200_000_000,
    0.02,
)  # ns before the log ends, m/s of a palm that moves; ours
MIN_MODEL_POINTS = 20  # fewer points of the robot's own model say nothing of where the object is


@dataclass(frozen=True)
class Recorded:
    """The robot's beliefs and commands as recorded; all empty where a log has none.

    grasps: T_base_palm chosen. targets: T_camera_model, the robot's model frame. seen_ns (n,):
    stamps of the images in which it saw the target itself. velocities, commands: (t_ns, twist
    (6,) m/s, rad/s), of the target and of the palm, base frame. model: points (n, 3) m of its
    model, model frame, recorded last before a time; None where there are none. source: `recorded`;
    `replayed_faithful` where a faithful replay's own beliefs stand for missing ones.
    """

    grasps: tuple[StampedPose, ...]
    targets: tuple[StampedPose, ...]
    seen_ns: NDArray[np.int64]
    velocities: tuple[tuple[int, Array], ...]
    commands: tuple[tuple[int, Array], ...]
    model: Callable[[int], Array | None]
    source: str = "recorded"

    @property
    def is_complete(self) -> bool:
        """Whether the robot recorded every kind of belief."""
        return bool(self.grasps and self.targets and self.velocities)

    def completed_by(self, replay: Replayed) -> Recorded:
        """The same with a faithful replay's own beliefs in place of those that are missing.

        Target and model go together: a model frame is its owner's.
        """
        if self.is_complete:
            return self
        own: dict[str, Any] = {"source": "replayed_faithful"}
        if not self.targets:
            own["targets"] = tuple(replay.targets)
            own["seen_ns"] = np.array(replay.seen_ns, dtype=np.int64)
            own["model"] = lambda _: replay.model
        if not self.velocities:
            own["velocities"] = tuple(replay.velocities)
        if not self.grasps:
            own["grasps"] = tuple(replay.grasps)
        return replace(self, **own)


@dataclass(frozen=True)
class HandEstimate:
    """What other trials show of this trial's hand, by its joints (k,), rad or m.

    closing: how it closes. empty (k,): where it comes to rest with nothing between its fingers.
    """

    closing: Closing | None = None
    empty: Array | None = None


NOTHING_ELSEWHERE = HandEstimate()


@dataclass(frozen=True)
class TrialLog:
    """One trial as a verdict sees it.

    first_ns, last_ns: first and last pair of images. limit_ns: where a manifest ends the trial.
    close_ns: the close command. close_missing: why no close is known, where that does not mean that
    there was none. label: an operator's, success or failure. damaged: not all of the recording can
    be read, or a part of it is not there. hand_samples: joint states that hold the fingers, in
    their own clock. max_gap_ns: longest gap in joint states that is interpolated. servo_gain: 1/s,
    of the robot's position servo, as configured. elsewhere: what other trials show of the hand.
    released_ns: when the fingers open again after the close. is_cut: no end of the trial is marked,
    and the hand still moves at the end of the log. untested: what the log is taken at its word for.
    motion_ns: of fingers whose last closing motion no lift follows, when it begins.
    """

    first_ns: int
    last_ns: int
    limit_ns: int | None
    close_ns: int | None
    close_missing: str | None
    label: str | None
    damaged: bool
    robot: RobotStates
    hand_samples: tuple[JointSample, ...]
    max_gap_ns: int
    servo_gain: float
    recorded: Recorded
    elsewhere: HandEstimate = NOTHING_ELSEWHERE
    released_ns: int | None = None
    is_cut: bool = False
    untested: tuple[str, ...] = ()
    motion_ns: int | None = None

    @property
    def end_ns(self) -> int:
        """The close, or the last pair of images without one."""
        return self.last_ns if self.close_ns is None else self.close_ns


def log_of(trial: Trial, elsewhere: HandEstimate | None = None) -> TrialLog:
    """What a verdict reads of a trial. Call it after the last pass over the images: reading them
    finds damage. elsewhere: what other trials show of its hand.
    """
    label = trial.spec.label or trial.events.label()
    scan = trial.scan
    close_ns = trial.event_ns(CLOSE_EVENT)
    released_ns = None
    if close_ns is not None and trial.robot.samples:
        until_ns = min(
            trial.robot.samples[-1].t_ns, trial.spec.end_ns or trial.robot.samples[-1].t_ns
        )
        released_ns = release_after(trial.robot, close_ns, until_ns, trial.event_ns(LIFT_EVENT))
        if released_ns is None and not fingers_seen(trial.robot, close_ns, until_ns):
            told = [t.released_ns(close_ns, until_ns) for t in gripper_tracks(scan, trial.robot)]
            released_ns = min((t for t in told if t is not None), default=None)
    stamps = np.zeros(0, dtype=np.int64)
    if MASK_TOPIC in scan.times:
        stamps = scan.times[MASK_TOPIC].arrays()[0]
    return TrialLog(
        trial.pairs[0].t_ns,
        trial.pairs[-1].t_ns,
        trial.spec.end_ns,
        close_ns,
        trial.close.missing,
        label,
        bool(trial.damage) or any(check.name == PART_CHECK for check in trial.checks),
        trial.robot,
        trial.robot.samples,
        round(trial.config.sync.max_pose_gap_s * 1e9),
        trial.config.servo.c_p_v,
        Recorded(
            tuple(scan.poses.get(GRASP_TOPIC, [])),
            tuple(scan.poses.get(TARGET_TOPIC, [])),
            stamps,
            tuple(scan.twists.get(VELOCITY_TOPIC, [])),
            tuple(scan.twists.get(COMMAND_TOPIC, [])),
            lambda t_ns: _model(trial.opened, t_ns),
        ),
        elsewhere or NOTHING_ELSEWHERE,
        released_ns,
        trial.event_ns(TRIAL_END_EVENT) is None and _moves_at_the_end(trial),
        trial.untested,
        trial.close.motion_ns,
    )


def _moves_at_the_end(trial: Trial) -> bool:
    """Whether the palm moves over the last of the recording's images; False where that is not
    known, or where the recording goes on after the trial.
    """
    last_ns = trial.pairs[-1].t_ns
    times = trial.scan.times.get(trial.roles.colour or "")
    if times is not None and max(times.arrays()[0], default=0) - last_ns > GOES_ON_NS:
        return False
    ends = [trial.robot.T_base_palm(t) for t in (last_ns - LAST_NS, last_ns)]
    if ends[0] is None or ends[1] is None:
        return False
    moved_m = float(np.linalg.norm(ends[1][:3, 3] - ends[0][:3, 3]))
    return moved_m > MOVES_M_S * LAST_NS * 1e-9


def _model(opened: Opened, t_ns: int) -> Array | None:
    """Points (n, 3) of the model recorded last before a time, or else first after it."""
    if MODEL_TOPIC not in opened.topics:
        return None
    last = None
    for message in opened.messages(frozenset({MODEL_TOPIC})):
        if message.log_ns > t_ns and last is not None:
            break
        last = message
    points = None if last is None else cloud_points(opened.decode(last))
    return None if points is None or len(points) < MIN_MODEL_POINTS else points
