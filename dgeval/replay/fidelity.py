"""Does this replay speak for the robot that was recorded? Its stages beside the robot's own values.

Each stage is held against what the robot recorded of it, over the last second before the decisive
instant and at that instant. Fewer than LEAST_VALUES recorded values there say nothing. Where the
replay draws at random, what two of its seeds are apart is no difference from the robot
(`fidelity.seeds`). A stage that is fed by others is also held against the robot's on the robot's
own inputs (`OwnInputs`): there a difference is its own.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config
from dgeval.errors import UndecodableError
from dgeval.geometry import (
    Array,
    invert,
    matrix_from_pose,
    pose_distance,
    rotation_angle,
    transform,
)
from dgeval.perception.types import Window
from dgeval.planning.control import Control
from dgeval.recording.contract import (
    COMMAND_TOPIC,
    MASK_TOPIC,
    TARGET_TOPIC,
    VELOCITY_TOPIC,
)
from dgeval.recording.images import decode_image
from dgeval.recording.trials import Trial
from dgeval.replay.causal import Step, grasp_source, recorded_decisions, replay
from dgeval.replay.own_inputs import OwnInputs, twist_error
from dgeval.replay.replayed import Replayed
from dgeval.replay.target_search import FoundTarget

LAST_S, LEAST_VALUES = 1.0, 10
MOST = 0.9  # quantile of the errors in the last second that must be within the bounds; ours
ALONE_MOST = 0.95  # the same on the robot's own inputs, where nothing is drawn; ours
NEAR_NS = 16_000_000  # ns; values of a frame that are stamped farther apart are none of it; ours
PERIOD_NS = 11_000_000  # ns, likewise of control periods
SAME = 0.05  # of a bound; a stage within that, on the robot's own inputs, is the robot's; ours
MOST_LATE_S, LATE_STEP_S = 0.2, 0.005  # s, delays that are tried; ours
LATE_GAIN = 0.5  # a delay is told where it takes this share off the error; ours
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
    is_faithful: None where too little is recorded to say, or two seeds of the replay are as far
    apart. agreement: share of the values that are within the bounds. late_s: by which the replay is
    later than the robot; 0 where no delay explains the error. spread: as errors, of other seeds of
    the replay beside it. alone: on the robot's own inputs, the ALONE_MOST quantile of the errors;
    none where they aren't recorded, or of a stage that isn't held so.
    """

    stage: str
    n: int
    errors: tuple[float, ...] = ()
    is_faithful: bool | None = None
    agreement: float | None = None
    late_s: float = 0.0
    spread: tuple[float, ...] = ()
    alone: tuple[float, ...] = ()

    @property
    def is_same(self) -> bool | None:
        """Whether the stage makes of the robot's own inputs what the robot did; None if unknown."""
        if not self.alone:
            return None
        bounds = BOUNDS[self.stage]
        return all(e <= SAME * b.most for e, b in zip(self.alone, bounds, strict=True))

    @property
    def is_other(self) -> bool:
        """Whether the stage itself is told as another than the robot's.

        By what it makes of the robot's own inputs where that is known, else by its result.
        """
        return self.is_faithful is False if self.is_same is None else not self.is_same

    @property
    def word(self) -> str:
        """For the table of trials."""
        return {True: "faithful", False: "not faithful", None: "not known"}[self.is_faithful]

    @property
    def told(self) -> str:
        """For the notes."""
        if self.is_faithful is None and not self.spread:
            return f"{self.stage} not known ({self.n} recorded values)"
        if not self.errors:
            return f"{self.stage}: the replay has none in most of {self.n} ({self.word})"
        more = [self.word]
        if self.agreement is not None and not self.is_faithful:
            more.append(f"{100 * self.agreement:.0f} % of {self.n} within the bounds")
        if self.late_s:
            side = "later" if self.late_s > 0 else "earlier"
            more.append(f"as if {side} by {abs(self.late_s) * 1e3:.0f} ms")
        if self.spread and not self.is_faithful:
            more.append(f"two seeds of the replay: {self._apart(self.spread)}")
        if self.alone:
            same = "the same" if self.is_same else self._apart(self.alone)
            more.append(f"on the robot's own inputs: {same}")
        sign = "" if np.isfinite(self.errors).all() else ":"
        return f"{self.stage}{sign} {self._values(self.errors)} ({'; '.join(more)})"

    def _apart(self, errors: Sequence[float]) -> str:
        """How far two are apart, in words."""
        values = self._values(errors)
        return f"{values} apart" if np.isfinite(errors).all() else values

    def _values(self, errors: Sequence[float]) -> str:
        """Errors in words."""
        if not np.isfinite(errors).all():
            return "one of the two never closes"
        bounds = BOUNDS[self.stage]
        return ", ".join(
            f"{_rounded(error * b.factor)}{b.unit}" for error, b in zip(errors, bounds, strict=True)
        )


class Compared:
    """What a replay and the robot say of each stage, gathered frame by frame."""

    def __init__(self, trial: Trial, config: Config) -> None:
        scan = trial.scan
        self._trial = trial
        self._targets = _in_order([(p.t_ns, p.pose) for p in scan.poses.get(TARGET_TOPIC, [])])
        self._velocities = _in_order(scan.twists.get(VELOCITY_TOPIC, []))
        self._commands = _in_order(scan.twists.get(COMMAND_TOPIC, []))
        self._choices = trial.choices
        source = grasp_source(trial.robot, self._choices, config.grasps)
        self._chooses = source in ("ffhnet", "candidates") and config.pipeline != "vfas"
        self._scores = source == "ffhnet"  # else the score is the robot's own
        own = recorded_decisions(self._choices, source, config)
        self._decides = own is None and source != "candidates" and config.pipeline != "vfas"
        self._errors: dict[str, list[tuple[int, tuple[float, ...]]]] = defaultdict(list)
        # of stages whose delay is looked for: times ns, ours and theirs there (k,)
        self._ours: dict[str, list[tuple[int, Array]]] = defaultdict(list)
        self._theirs: dict[str, list[tuple[int, Array]]] = defaultdict(list)
        self._alone = OwnInputs(trial, config)
        self._masks: list[tuple[int, Window, tuple[int, ...], NDArray[np.uint8]]] = []
        # T_camera_model (4, 4) of both in the first frame in which the target was seen by both
        self._first: tuple[Array, Array] | None = None
        self._decided_ns: int | None = None
        self.own = Replayed()

    def add(self, step: Step) -> None:
        """One frame, with the control periods before it."""
        self.own.add(step)
        t_ns = step.frame.t_ns
        for control, alone in zip_longest(step.periods, self._alone.periods(step)):
            self._add_period(control, alone)
        T_by_them = self._add_target(step)
        velocity = _nearest(*self._velocities, t_ns, NEAR_NS)
        estimate = step.perceived.estimate
        if velocity is not None and estimate is not None:
            apart = float(np.linalg.norm(estimate.velocity - velocity[:3]))
            self._errors["velocity"].append((t_ns, (apart,)))
            self._beside("velocity", t_ns, estimate.velocity, velocity[:3])
        self._alone.add(step, T_by_them, None if velocity is None else velocity[:3])
        mask, window = step.tracked.mask, step.tracked.window
        # the robot's masks are of its own pictures, not of those that the lens was taken out of
        trial = self._trial
        comparable = MASK_TOPIC in trial.scan.times and trial.reader.camera.lens is None
        if mask is not None and window is not None and comparable:
            self._masks.append((t_ns, window, mask.shape, np.packbits(mask)))

    def _beside(self, stage: str, t_ns: int, ours: Array, theirs: Array) -> None:
        self._ours[stage].append((t_ns, ours))
        self._theirs[stage].append((t_ns, theirs))

    def _add_target(self, step: Step) -> Array | None:
        """T_camera_model (4, 4) by the robot, in the axes of the replay's model; None without."""
        recorded = _nearest(*self._targets, step.frame.t_ns, NEAR_NS)
        ours, model = step.T_camera_model, step.model
        if recorded is None or ours is None or model is None:
            return None
        theirs = matrix_from_pose(recorded)
        if self._first is None:
            if not step.accepted:
                return None
            self._first = ours, theirs
        # their model has axes of its own: what both have done since the first frame is compared
        T_by_them = theirs @ invert(self._first[1]) @ self._first[0]
        centre = model.points.mean(axis=0)[None]
        apart = transform(T_by_them, centre) - transform(ours, centre)
        turn = rotation_angle(T_by_them[:3, :3].T @ ours[:3, :3])
        self._errors["target"].append(
            (step.frame.t_ns, (float(np.linalg.norm(apart)), float(turn)))
        )
        T_base_camera = step.T_base_camera
        if T_base_camera is not None:
            own, their = (transform(T_base_camera @ T, centre)[0] for T in (ours, T_by_them))
            self._beside("target", step.frame.t_ns, own, their)
        return T_by_them

    def _add_period(self, control: Control, alone: Control | None) -> None:
        """alone: the period on the robot's own inputs; None where it recorded too little."""
        t_ns = control.t_ns
        command = _nearest(*self._commands, t_ns, PERIOD_NS)
        if command is not None and control.command is not None:
            self._errors["twist"].append((t_ns, (twist_error(control, command),)))
            self._beside("twist", t_ns, control.command.twist[:3], command[:3])
        if command is not None and alone is not None:
            self._alone.add_twist(alone, command)
        if self._decides and control.execute and self._decided_ns is None:
            self._decided_ns = t_ns
        if not self._chooses or control.grasps is None or control.grasps.choice is None:
            return
        choice, recorded = control.grasps.choice, self._choices
        grasp, score = recorded.grasp_at(t_ns), recorded.hand_scores.at(t_ns)
        if grasp is not None:
            errors = pose_distance(choice.T_base_palm, grasp)
            self._errors["grasp"].append((t_ns, errors))
            if any(e > b.most for e, b in zip(errors, BOUNDS["grasp"], strict=True)):
                score = None  # of the hand with the fingers of another grasp
            self._beside("grasp", t_ns, choice.T_base_palm[:3, 3], grasp[:3, 3])
        if self._scores and score is not None and choice.hand_score is not None:
            self._errors["score"].append((t_ns, (abs(choice.hand_score - score),)))

    def until(
        self, t_ns: int, spread: Mapping[str, tuple[float, ...]] | None = None
    ) -> tuple[Fidelity, ...]:
        """The stages of which the robot recorded something, at the decisive instant t_ns.

        spread: of the replay's seeds, as `spread_of` found it.
        """
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
        listed = [*out, *([decided] if decided is not None else [])]
        completed = [self._completed(one, t_ns) for one in listed]
        return tuple(_beside_seeds(one, (spread or {}).get(one.stage, ())) for one in completed)

    def _completed(self, one: Fidelity, t_ns: int) -> Fidelity:
        """With its delay, and its errors on the robot's own inputs."""
        since = t_ns - round(LAST_S * 1e9)
        ours, theirs = (
            [v for v in series[one.stage] if since <= v[0] <= t_ns]
            for series in (self._ours, self._theirs)
        )
        late_s = _delay(ours, theirs, SAME * BOUNDS[one.stage][0].most)
        alone: tuple[float, ...] = ()
        if one.stage in self._alone.errors:
            last = [e for t, e in self._alone.errors[one.stage] if since <= t <= t_ns]
            if len(last) >= LEAST_VALUES:
                alone = tuple(np.quantile(np.array(last), ALONE_MOST, axis=0).tolist())
        if one.stage == "decision" and self._alone.decides and one.n >= LEAST_VALUES:
            alone = (_apart_s(self._alone.decided_ns, self._their_decision()),)
        return replace(one, late_s=late_s, alone=alone)

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
        if n < LEAST_VALUES:
            return Fidelity("decision", n)
        late = _apart_s(self._decided_ns, self._their_decision())
        return Fidelity("decision", n, (late,), late <= BOUNDS["decision"][0].most)

    def _their_decision(self) -> int | None:
        """When the robot decided to close, ns."""
        decisions = self._choices.decisions
        return next((t for t, v in zip(decisions.times, decisions.values, strict=True) if v), None)

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


def spread_of(
    trial: Trial, config: Config, own: Replayed, t_ns: int, target: FoundTarget | None = None
) -> dict[str, tuple[float, ...]]:
    """How far other seeds of a replay are from it, of each stage, as `Fidelity.errors`.

    own: the replay. t_ns: the decisive instant. target: as `search_target` found it. One more
    replay for each of `fidelity.seeds`.
    """
    robot = own.as_robot(trial)
    source = grasp_source(trial.robot, trial.choices, config.grasps)
    out: dict[str, tuple[float, ...]] = {}
    for k in range(config.fidelity.seeds):
        grasps = config.grasps.model_copy(update={"source": source})
        other = config.model_copy(update={"seed": config.seed + k + 1, "grasps": grasps})
        compared = Compared(robot, other)
        for step in replay(trial, other, target=target):
            compared.add(step)
        for one in compared.until(t_ns):
            if one.errors:
                before = out.get(one.stage, one.errors)
                out[one.stage] = tuple(map(max, before, one.errors))
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
    most = np.array([b.most for b in BOUNDS[stage]])
    agreement = float((np.array(last) <= most).all(axis=1).mean())
    faithful = bool((worst <= most).all())
    return Fidelity(stage, len(last), tuple(worst.tolist()), faithful, agreement)


def _beside_seeds(one: Fidelity, spread: tuple[float, ...]) -> Fidelity:
    """With the spread of the replay's seeds; where that is as far apart, nothing is known."""
    if not spread or not one.errors:
        return one
    bounds = BOUNDS[one.stage]
    excused = all(e <= max(b.most, s) for e, b, s in zip(one.errors, bounds, spread, strict=True))
    is_faithful = None if one.is_faithful is False and excused else one.is_faithful
    return replace(one, spread=spread, is_faithful=is_faithful)


def _rounded(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def _apart_s(ours_ns: int | None, theirs_ns: int | None) -> float:
    """How far two decisions are apart, s; 0 where neither closes, infinite where one does."""
    if ours_ns is None or theirs_ns is None:
        return 0.0 if ours_ns is None and theirs_ns is None else np.inf
    return abs(ours_ns - theirs_ns) * 1e-9


def _delay(
    ours: Sequence[tuple[int, Array]], theirs: Sequence[tuple[int, Array]], least: float
) -> float:
    """By how much ours are later, s, where that explains an error above `least`; else 0."""
    if len(ours) < LEAST_VALUES:
        return 0.0
    t = np.array([t for t, _ in theirs], float) * 1e-9
    values, own = np.array([v for _, v in theirs]), np.array([v for _, v in ours])

    def apart(late_s: float) -> float:
        at = t - late_s
        inside = (at >= t[0]) & (at <= t[-1])
        if inside.sum() < LEAST_VALUES:
            return np.inf
        then = np.column_stack([np.interp(at[inside], t, column) for column in values.T])
        return round(float(np.linalg.norm(own[inside] - then, axis=1).mean()), 9)

    none = apart(0.0)
    offset = float(np.linalg.norm(own - values - (own - values).mean(axis=0), axis=1).mean())
    steps = round(MOST_LATE_S / LATE_STEP_S)
    lates = [k * LATE_STEP_S for k in range(-steps, steps + 1) if t[-1] - t[0] > 2 * MOST_LATE_S]
    # an offset that never changes is one, though along a steady motion a delay would look the same
    if none <= least or offset <= LATE_GAIN * none or not lates:
        return 0.0
    best = min(lates, key=lambda late_s: (apart(late_s), abs(late_s)))
    return best if apart(best) <= LATE_GAIN * none else 0.0


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
