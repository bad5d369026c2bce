"""Does this replay speak for the robot that was recorded? Its stages beside the robot's own values.

Each stage is held against what the robot recorded of it, over the last second before the decisive
instant and at that instant. Fewer than LEAST_VALUES recorded values there say nothing.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config
from dgeval.errors import UndecodableError
from dgeval.geometry import (
    Array,
    invert,
    matrix_from_pose,
    pose_from_matrix,
    rotation_angle,
    transform,
)
from dgeval.perception.types import Window
from dgeval.planning.control import Control
from dgeval.recording.contract import COMMAND_TOPIC, MASK_TOPIC, TARGET_TOPIC, VELOCITY_TOPIC
from dgeval.recording.images import decode_image
from dgeval.recording.messages import StampedPose
from dgeval.recording.trials import Trial
from dgeval.replay.causal import Step, grasp_source, recorded_decisions

LAST_S, LEAST_VALUES = 1.0, 10
MOST = 0.9  # quantile of the errors in the last second that must be within the bounds; ours
NEAR_NS = 16_000_000  # ns; values of a frame that are stamped farther apart are none of it; ours
PERIOD_NS = 11_000_000  # ns, likewise of control periods
# m per rad, by which a turn counts in a twist; m/s, the least size that a twist is measured by
ARM_M, LEAST_TWIST = 0.1, 0.02
DEGREES = 180.0 / np.pi


@dataclass(frozen=True)
class Bound:
    """The largest error of a faithful stage. shown: factor and unit in which it is told."""

    most: float
    factor: float
    unit: str


MM, DEG = Bound(0.005, 1e3, " mm"), Bound(np.radians(3.0), DEGREES, "°")
BOUNDS: Mapping[str, tuple[Bound, ...]] = {
    "target": (MM, DEG),
    "velocity": (Bound(0.010, 1e3, " mm/s"),),
    "mask": (Bound(0.2, 100.0, " % not shared"),),
    "grasp": (MM, DEG),
    "score": (Bound(0.05, 1.0, ""),),
    "twist": (Bound(0.10, 100.0, " %"),),
    "decision": (Bound(0.011, 1e3, " ms"),),
}


@dataclass(frozen=True)
class Fidelity:
    """One stage beside the robot's own values.

    n: recorded values in the last second. errors: the MOST quantile of each of BOUNDS[stage] in it,
    or that at the instant if it is larger; none where the replay has nothing beside most of them.
    is_faithful: None where too little is recorded to say.
    """

    stage: str
    n: int
    errors: tuple[float, ...] = ()
    is_faithful: bool | None = None

    @property
    def word(self) -> str:
        """For the table of trials."""
        return {True: "faithful", False: "not faithful", None: "not known"}[self.is_faithful]

    @property
    def told(self) -> str:
        """For the notes."""
        if self.is_faithful is None:
            return f"{self.stage} not known ({self.n} recorded values)"
        if not self.errors:
            return f"{self.stage}: the replay has none in most of {self.n} ({self.word})"
        if self.stage == "decision" and not np.isfinite(self.errors).all():
            return f"{self.stage}: one of the two never closes ({self.word})"
        bounds = BOUNDS[self.stage]
        values = ", ".join(
            f"{error * b.factor:.2g}{b.unit}" for error, b in zip(self.errors, bounds, strict=True)
        )
        return f"{self.stage} {values} ({self.word})"


@dataclass
class Replayed:
    """What the replay itself believed and chose, as a robot would have recorded it.

    targets: T_camera_model, in each frame; seen_ns: times of those that were accepted. velocities:
    (t_ns, twist (6,)), base frame. grasps: T_base_palm chosen, in each control period. model: its
    last points (n, 3) m, model frame.
    """

    targets: list[StampedPose] = field(default_factory=list)
    seen_ns: list[int] = field(default_factory=list)
    velocities: list[tuple[int, Array]] = field(default_factory=list)
    grasps: list[StampedPose] = field(default_factory=list)
    model: Array | None = None

    def add(self, step: Step) -> None:
        t_ns, estimate = step.frame.t_ns, step.perceived.estimate
        if step.T_camera_model is not None:
            self.targets.append(StampedPose(t_ns, "", "", pose_from_matrix(step.T_camera_model)))
        if step.accepted:
            self.seen_ns.append(t_ns)
        if step.model is not None:
            self.model = step.model.points
        if estimate is not None:
            self.velocities.append((t_ns, np.append(estimate.velocity, np.zeros(3))))
        for control in step.periods:
            choice = None if control.grasps is None else control.grasps.choice
            if choice is not None:
                pose = pose_from_matrix(choice.T_base_palm)
                self.grasps.append(StampedPose(control.t_ns, "", "", pose))


class Compared:
    """What a replay and the robot say of each stage, gathered frame by frame."""

    def __init__(self, trial: Trial, config: Config) -> None:
        scan = trial.scan
        self._trial = trial
        self._targets = _in_order([(p.t_ns, p.pose) for p in scan.poses.get(TARGET_TOPIC, [])])
        self._velocities = _in_order(scan.twists.get(VELOCITY_TOPIC, []))
        self._commands = _in_order(scan.twists.get(COMMAND_TOPIC, []))
        self._choices = trial.choices
        source = grasp_source(trial.robot, bool(self._choices.times), config.grasps)
        self._chooses = source == "ffhnet" and config.pipeline != "vfas"
        own = recorded_decisions(self._choices, source, config)
        self._decides = own is None and config.pipeline != "vfas"
        self._errors: dict[str, list[tuple[int, tuple[float, ...]]]] = defaultdict(list)
        self._masks: list[tuple[int, Window, tuple[int, ...], NDArray[np.uint8]]] = []
        # T_camera_model (4, 4) of both in the first frame in which the target was seen by both
        self._first: tuple[Array, Array] | None = None
        self._decided_ns: int | None = None
        self.own = Replayed()

    def add(self, step: Step) -> None:
        """One frame, with the control periods before it."""
        self.own.add(step)
        t_ns = step.frame.t_ns
        self._add_target(step)
        velocity = _nearest(*self._velocities, t_ns, NEAR_NS)
        estimate = step.perceived.estimate
        if velocity is not None and estimate is not None:
            apart = float(np.linalg.norm(estimate.velocity - velocity[:3]))
            self._errors["velocity"].append((t_ns, (apart,)))
        mask, window = step.tracked.mask, step.tracked.window
        # the robot's masks are of its own pictures, not of those that the lens was taken out of
        trial = self._trial
        comparable = MASK_TOPIC in trial.scan.times and trial.reader.camera.lens is None
        if mask is not None and window is not None and comparable:
            self._masks.append((t_ns, window, mask.shape, np.packbits(mask)))
        for control in step.periods:
            self._add_period(control)

    def _add_target(self, step: Step) -> None:
        recorded = _nearest(*self._targets, step.frame.t_ns, NEAR_NS)
        ours, model = step.T_camera_model, step.model
        if recorded is None or ours is None or model is None:
            return
        theirs = matrix_from_pose(recorded)
        if self._first is None:
            if not step.accepted:
                return
            self._first = ours, theirs
        # their model has axes of its own: what both have done since the first frame is compared
        T_by_them = theirs @ invert(self._first[1]) @ self._first[0]
        centre = model.points.mean(axis=0)[None]
        apart = transform(T_by_them, centre) - transform(ours, centre)
        turn = rotation_angle(T_by_them[:3, :3].T @ ours[:3, :3])
        self._errors["target"].append(
            (step.frame.t_ns, (float(np.linalg.norm(apart)), float(turn)))
        )

    def _add_period(self, control: Control) -> None:
        t_ns = control.t_ns
        command = _nearest(*self._commands, t_ns, PERIOD_NS)
        if command is not None and control.command is not None:
            scale = np.array([1.0] * 3 + [ARM_M] * 3)
            apart = float(np.linalg.norm((control.command.twist - command) * scale))
            size = max(float(np.linalg.norm(command * scale)), LEAST_TWIST)
            self._errors["twist"].append((t_ns, (apart / size,)))
        if self._decides and control.execute and self._decided_ns is None:
            self._decided_ns = t_ns
        if not self._chooses or control.grasps is None or control.grasps.choice is None:
            return
        choice, recorded = control.grasps.choice, self._choices
        grasp, score = recorded.grasp_at(t_ns), recorded.hand_scores.at(t_ns)
        if grasp is not None:
            metres = float(np.linalg.norm(choice.T_base_palm[:3, 3] - grasp[:3, 3]))
            turn = rotation_angle(choice.T_base_palm[:3, :3].T @ grasp[:3, :3])
            self._errors["grasp"].append((t_ns, (metres, float(turn))))
        if score is not None and choice.hand_score is not None:
            self._errors["score"].append((t_ns, (abs(choice.hand_score - score),)))

    def until(self, t_ns: int) -> tuple[Fidelity, ...]:
        """The stages of which the robot recorded something, at the decisive instant t_ns."""
        self._errors["mask"] = self._mask_errors(t_ns)
        theirs = {
            "target": self._targets[0],
            "velocity": self._velocities[0],
            "twist": self._commands[0],
        }
        out = [
            _fidelity(stage, self._errors[stage], theirs.get(stage, []), t_ns)
            for stage in BOUNDS
            if stage != "decision" and (self._errors[stage] or theirs.get(stage))
        ]
        decided = self._decision(t_ns)
        return (*out, decided) if decided is not None else tuple(out)

    def speaks(self, t_ns: int) -> bool:
        """Whether the replay's own beliefs up to t_ns may stand for the robot's.

        Its commands are the robot's, which follow from target, velocity and grasp, and no stage
        that the robot recorded is another.
        """
        if not self._commands[0]:  # no twist to compare; the masks need not be decoded for that
            return False
        words = {one.stage: one.is_faithful for one in self.until(t_ns)}
        return words.get("twist") is True and False not in words.values()

    def _decision(self, t_ns: int) -> Fidelity | None:
        """When the robot and the replay decide to close; agreed where neither does."""
        decisions = self._choices.decisions
        if not self._decides or not decisions.times:
            return None
        n = sum(t_ns - LAST_S * 1e9 <= t <= t_ns for t in decisions.times)
        theirs = next(
            (t for t, v in zip(decisions.times, decisions.values, strict=True) if v), None
        )
        if n < LEAST_VALUES:
            return Fidelity("decision", n)
        if theirs is None or self._decided_ns is None:
            agree = theirs is None and self._decided_ns is None
            return Fidelity("decision", n, (0.0 if agree else np.inf,), agree)
        late = abs(self._decided_ns - theirs) * 1e-9
        return Fidelity("decision", n, (late,), late <= BOUNDS["decision"][0].most)

    def _mask_errors(self, t_ns: int) -> list[tuple[int, tuple[float, ...]]]:
        """1 - IoU of the masks in the last second."""
        since = t_ns - round(LAST_S * 1e9)
        ours = [mask for mask in self._masks if since <= mask[0] <= t_ns]
        if not ours:
            return []
        times, theirs = _masks(self._trial, since - NEAR_NS, t_ns + NEAR_NS)
        out: list[tuple[int, tuple[float, ...]]] = []
        for t, window, shape, packed in ours:
            mask = _nearest(times, theirs, t, NEAR_NS)
            if mask is not None:
                own = np.unpackbits(packed, count=int(np.prod(shape))).reshape(shape) > 0
                out.append((t, (1.0 - _shared(own, window, mask > 0),)))
        return out


def fidelity_notes(stages: Sequence[Fidelity]) -> list[str]:
    """One note on how near the replay is to the robot's own values; none where none is recorded."""
    told = ", ".join(one.told for one in stages)
    return [f"the replay beside the robot's own values in the last second: {told}"] if told else []


def _fidelity(
    stage: str,
    errors: Sequence[tuple[int, tuple[float, ...]]],
    recorded: Sequence[int],
    t_ns: int,
) -> Fidelity:
    """recorded: times of what the robot recorded, ns; a replay that has none of it is no answer."""
    since = t_ns - LAST_S * 1e9
    last = [e for t, e in errors if since <= t <= t_ns]
    theirs = sum(since <= t <= t_ns for t in recorded)
    if theirs >= LEAST_VALUES and stage != "twist" and 2 * len(last) < theirs:
        return Fidelity(stage, theirs, (), False)
    if len(last) < LEAST_VALUES:
        return Fidelity(stage, max(len(last), theirs))
    worst = np.maximum(np.quantile(np.array(last), MOST, axis=0), last[-1])
    faithful = all(e <= b.most for e, b in zip(worst.tolist(), BOUNDS[stage], strict=True))
    return Fidelity(stage, len(last), tuple(worst.tolist()), faithful)


def _in_order(listed: Sequence[tuple[int, Array]]) -> tuple[list[int], list[Array]]:
    """Times ns and values, in time order."""
    ordered = sorted(listed, key=lambda value: value[0])
    return [t for t, _ in ordered], [value for _, value in ordered]


def _nearest(
    times: Sequence[int], values: Sequence[Array], t_ns: int, within_ns: int
) -> Array | None:
    """The value nearest in time; None where none is within within_ns."""
    at = bisect_left(times, t_ns)
    near = [k for k in (at - 1, at) if 0 <= k < len(times)]
    if not near:
        return None
    k = min(near, key=lambda k: abs(times[k] - t_ns))
    return values[k] if abs(times[k] - t_ns) <= within_ns else None


def _masks(trial: Trial, since: int, until: int) -> tuple[list[int], list[Array]]:
    """The robot's own masks (H, W) of the pictures' size, with their stamps, ns."""
    stamps = trial.scan.times[MASK_TOPIC].arrays()[0].tolist()
    size, found = (trial.camera.height, trial.camera.width), []
    for stamp, message in zip(stamps, trial.opened.messages(frozenset({MASK_TOPIC})), strict=False):
        if since <= stamp <= until:
            try:
                pixels = decode_image(trial.opened.decode(message)).array
            except (UndecodableError, ValueError):
                continue
            if pixels.shape[:2] == size:
                found.append((stamp, pixels.reshape(*size, -1).max(axis=2) > 0))
    return _in_order(found)


def _shared(ours: NDArray[np.bool_], window: Window, theirs: NDArray[np.bool_]) -> float:
    """IoU of a mask of a window px and one of the whole picture (H, W)."""
    x0, y0, x1, y1 = window
    both = int((theirs[y0:y1, x0:x1] & ours).sum())
    return both / max(int(theirs.sum()) + int(ours.sum()) - both, 1)
