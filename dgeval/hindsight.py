"""The second pass: the same log with the future allowed.

The final model is looked for again in every frame in which the causal pass did not find it, from where the smoothed path
says it must be: through the blind gap in colour, after the close, and after the lift. What the causal pass accepted and
what this finds is smoothed in one piece up to the first contact; beyond it the object's free path is extrapolated, and
sightings say what it really did. Nothing here reads the truth or the robot's beliefs.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, invert, rotation_angle, transform
from dgeval.perception.pipeline import Perception
from dgeval.perception.plane import Plane
from dgeval.perception.registration import register
from dgeval.perception.self_filter import signed_distance
from dgeval.perception.trackers.model import ModelTracker
from dgeval.perception.types import Model, Observation
from dgeval.recording.frame import Frame
from dgeval.recording.trials import GRASP_TOPIC, Trial
from dgeval.replay import Step
from dgeval.stages.smoothing import Path, Sighting, smooth

GapSided = Literal["none", "one", "two"]
KnownBy = Literal["path", "registration", "depth", "colour", "hand", "support"]
CONTACT_M = 0.006  # m; a hand this near may be pushing: measured clouds are not more exact
NO_GAP_S = 0.1
WINDOW_BEFORE_S, WINDOW_AFTER_S = 4.0, 4.0  # around the close, where frames are looked at again
CELL = 0.003  # m; of the surface that is kept
FIRST_S = 0.5  # from which the path is begun
OFF_PATH_M, OFF_PATH_RAD, OFF_PATH_COUNT = 0.006, 0.12, 3  # sightings in a row this far off the path so far
PUSHING_M = 0.030  # m; hand to the sighted object, when it leaves its path
MIN_COLOUR = 12  # features
CARRIED_S, APART_M = 1.0, 0.01  # a sighting is a prior for so long, where it is so far from the others
MOST_MISSED = 45  # frames kept to be gone through backwards
BACKWARD_NS = 250_000_000  # from one frame to the one before it, in going backwards
RISEN_M, HELD_M = 0.05, 0.015  # the palm off its place at the close; the object off its place in the palm


class Surface:
    """All that was ever fused, thinned by cells instead of at random, so that what was seen early is not forgotten.

    The paper's model keeps a random subset: after some tens of near frames it holds little but the last view.
    """

    def __init__(self) -> None:
        self._cells = np.zeros(0, dtype=np.int64)
        self._sums = np.zeros((0, 7))  # position, normal, count

    def add(self, model: Model) -> None:
        """Merge a model cloud; call with accepted frames only."""
        at = np.floor(model.points / CELL).astype(np.int64) + 2**20
        cells, inverse = np.unique((at[:, 0] << 42) | (at[:, 1] << 21) | at[:, 2], return_inverse=True)
        sums = np.zeros((len(cells), 7))
        np.add.at(sums, inverse, np.column_stack([model.points, model.normals, np.ones(len(at))]))
        both = np.union1d(self._cells, cells)
        merged = np.zeros((len(both), 7))
        merged[np.searchsorted(both, self._cells)] = self._sums
        merged[np.searchsorted(both, cells)] += sums
        self._cells, self._sums = both, merged

    def model(self) -> Model | None:
        """Points and unit normals of the cells; None where nothing was added."""
        if not len(self._cells):
            return None
        points = self._sums[:, :3] / self._sums[:, 6:]
        normals = self._sums[:, 3:6]
        return Model(points, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9))


@dataclass(frozen=True)
class Seen:
    """One frame of the causal pass.

    T_camera_model: the accepted one, or None; T_tracked: the tracker's own word where it had the target, by depth or by
    `n_features` in colour. support: what the object stands on, base frame.
    """

    index: int
    t_ns: int
    T_base_camera: Array
    T_camera_model: Array | None
    T_tracked: Array | None
    n_features: int
    n_depth: int
    support: Plane | None


@dataclass(frozen=True, slots=True)
class Moment:
    """Where hindsight has the object in a frame: T_base_model, and how it knows; the nearest link of the hand.

    by: `path` (undisturbed), a sighting's word, `hand` (moves with the hand), `support` (pushed, moves on with what it
    stands on). sd m of the position, None but on the path. distance: signed, m, None without hand geometry.
    """

    index: int
    t_ns: int
    T_base_model: Array
    by: KnownBy
    sd: float | None
    distance: float | None
    link: str | None


@dataclass(frozen=True)
class Hindsight:
    """What the whole log says about the object.

    contact_ns: first time before the close at which the hand was within CONTACT_M of it on its free path, and the link.
    pushed_ns: when it was seen to leave that path with the hand at it. n_registered: sightings by an accepted registration
    up to the close. gap_s: from the last sighting to the close; None without a close. moments: frame by frame from
    WINDOW_BEFORE_S before the close on; empty without an attempt.
    """

    path: Path
    sightings: tuple[Sighting, ...]
    points: Array
    support: Plane | None
    contact_ns: int | None
    contact_link: str | None
    pushed_ns: int | None
    n_registered: int
    gap_s: float | None
    gap_sided: GapSided
    moments: tuple[Moment, ...]
    notes: tuple[str, ...]


def seen_of(step: Step) -> Seen | None:
    """What the second pass needs of a frame of the first; None where the camera's pose is not known."""
    if step.T_base_camera is None:
        return None
    plane = step.tracked.plane
    support = None if plane is None else plane.moved(step.T_base_camera)
    accepted = step.T_camera_model if step.accepted else None
    tracked = step.tracked
    n_features = 0 if tracked.features is None else len(tracked.features.points)
    T_tracked = tracked.T_camera_model if tracked.state == "tracked" else None
    frame = step.frame
    return Seen(frame.index, frame.t_ns, step.T_base_camera, accepted, T_tracked, n_features, tracked.mask_area, support)


def look_back(trial: Trial, seen: list[Seen], surface: Surface, perception: Perception, config: Config) -> Hindsight | None:
    """Second pass over one trial. None where the causal pass never had a model and a pose to start from."""
    model = surface.model()
    accepted = [s for s in seen if s.T_camera_model is not None]
    if model is None or not accepted:
        return None
    centroid = model.points.mean(axis=0)
    sightings = _causal(seen, config)
    end_ns = trial.event_ns("close") or seen[-1].t_ns
    path, _ = _free_path(trial, sightings, model, centroid, end_ns)
    support = _support(seen)

    tracker = perception.tracker if isinstance(perception.tracker, ModelTracker) else ModelTracker(config)
    known = {s.t_ns for s in sightings}
    # without a grasp in the log nobody asks for what a second look would add
    attempt = trial.event_ns("close") is not None or bool(trial.scan.poses.get(GRASP_TOPIC))
    wanted = {
        s.index: s
        for s in seen
        if attempt and s.t_ns not in known and -WINDOW_BEFORE_S <= (s.t_ns - end_ns) * 1e-9 <= WINDOW_AFTER_S
    }
    missed: deque[Frame] = deque(maxlen=MOST_MISSED)
    for frame in trial.frames() if wanted else ():
        if frame.index not in wanted:
            continue
        here: Frame | None = frame
        while here is not None:
            # found again, it is followed backwards through the frames before, until one where it is not
            priors = _priors(here.t_ns, path, sightings, trial, end_ns)
            sighting = _look(here, wanted[here.index], tracker, model, priors, config)
            if sighting is None:
                if here is frame:
                    missed.append(frame)
                break
            insort(sightings, sighting, key=lambda s: s.t_ns)
            here = missed.pop() if missed and here.t_ns - missed[-1].t_ns < BACKWARD_NS else None
    path, pushed_ns = _free_path(trial, sightings, model, centroid, end_ns)
    moments = _moments(trial, seen, path, sightings, model, pushed_ns, end_ns) if attempt else ()
    contact = next((m for m in moments if m.t_ns <= end_ns and m.distance is not None and m.distance < CONTACT_M), None)
    notes = [] if support is not None else ["hindsight: no support plane was seen"]
    close_ns = trial.event_ns("close")
    gap, sided = blind_gap([s.t_ns for s in sightings], close_ns)
    registered = sum(s.by == "registration" and s.t_ns <= end_ns for s in sightings)
    return Hindsight(
        path,
        tuple(sightings),
        model.points,
        support,
        None if contact is None else contact.t_ns,
        None if contact is None else contact.link,
        pushed_ns,
        registered,
        gap,
        sided,
        moments,
        tuple(notes),
    )


def _causal(seen: list[Seen], config: Config) -> list[Sighting]:
    """What the first pass saw, the best word on each frame."""
    out = []
    for s in seen:
        if s.T_camera_model is not None:
            out.append(Sighting(s.t_ns, s.T_base_camera @ s.T_camera_model, "registration", False))
        elif s.T_tracked is not None and s.n_depth >= config.observation.min_points:
            out.append(Sighting(s.t_ns, s.T_base_camera @ s.T_tracked, "depth", False))
        elif s.T_tracked is not None and s.n_features >= MIN_COLOUR:
            out.append(Sighting(s.t_ns, s.T_base_camera @ s.T_tracked, "colour", False))
    return out


def _free_path(trial: Trial, sightings: list[Sighting], model: Model, centroid: Array, end_ns: int) -> tuple[Path, int | None]:
    """The undisturbed path, and when the object left it with the hand at it (the change point), or None.

    Sightings are taken in one after the other. Where several in a row lie off the path so far, it was a push if the hand
    is at the object then, else its own motion, which the path follows.
    """
    before = [s for s in sightings if s.t_ns <= end_ns] or sightings[:1]
    first = max(2, sum((s.t_ns - before[0].t_ns) * 1e-9 < FIRST_S for s in before))
    used, off = before[:first], list[Sighting]()
    path = smooth(used, centroid)
    for s in before[first:]:
        there = path.at(s.t_ns)
        apart = float(np.linalg.norm(transform(s.T_base_model, centroid[None]) - transform(there, centroid[None])))
        turned = rotation_angle(s.T_base_model[:3, :3].T @ there[:3, :3])
        if apart < OFF_PATH_M + 2 * path.sd_at(s.t_ns) and turned < OFF_PATH_RAD + min(2 * path.sd_angle, 0.05):
            used, off = [*used, *off, s], []
            if len(used) % 5 == 0 or len(used) < 15:
                path = smooth(used, centroid)
            continue
        off.append(s)
        if len(off) == OFF_PATH_COUNT:
            step = max(1, len(model.points) // 400)
            near = [hand_distance(trial, o.t_ns, transform(o.T_base_model, model.points[::step])) for o in off]
            if any(n is not None and n[0] < PUSHING_M for n in near):
                return smooth(used, centroid), off[0].t_ns
            used, off = [*used, *off], []
            path = smooth(used, centroid)
    return smooth(used, centroid), None


def _support(seen: list[Seen]) -> Plane | None:
    """The surface the object stands on, base frame: the median of what the frames say."""
    planes = [s.support for s in seen if s.support is not None]
    if not planes:
        return None
    n = np.median([p.n for p in planes], axis=0)
    n /= np.linalg.norm(n)
    near = [p for p in planes if p.n @ n > 0.98]
    if not near:
        return None
    return Plane(n, float(np.median([p.d for p in near])), float(len(near) / len(planes)))


def hand_distance(trial: Trial, t_ns: int, points_base: Array) -> tuple[float, str] | None:
    """Least signed distance m of the recorded hand to points (n, 3), base frame, and the link; None without hand geometry."""
    near = nearest_link(trial, t_ns, points_base, None)
    return None if near is None else (near[1], near[0])


def nearest_link(trial: Trial, t_ns: int, points_base: Array, link: str | None) -> tuple[str, float, Array, Array] | None:
    """Nearest link (or how near the named one is): name, signed distance m, its middle, nearest point (base frame)."""
    shapes = trial.robot.hand_shapes(t_ns)
    T_base_camera = trial.robot.T_base_camera(t_ns)
    if shapes is None or T_base_camera is None:
        return None
    best: tuple[str, float, Array, Array] | None = None
    in_camera = transform(invert(T_base_camera), points_base)
    middle = in_camera.mean(axis=0)
    for shape, T_camera_shape in shapes:
        if link is not None and shape.link != link:
            continue
        if float(np.linalg.norm(middle - T_camera_shape[:3, 3])) > 0.4 + shape.bound:
            continue
        d = signed_distance(shape, transform(invert(T_camera_shape), in_camera))
        k = int(np.argmin(d))
        if best is None or d[k] < best[1]:
            best = shape.link, float(d[k]), transform(T_base_camera, T_camera_shape[None, :3, 3])[0], points_base[k]
    return best


def _moments(
    trial: Trial, seen: list[Seen], path: Path, sightings: list[Sighting], model: Model, pushed_ns: int | None, end_ns: int
) -> tuple[Moment, ...]:
    """The object in every frame from some seconds before the close on, and the hand's nearest link.

    Up to the push, or the close, it is on its path. Afterwards it is where it is seen; between sightings it moves with the
    hand if it was seen to, else, up to the close, with what it stands on.
    """
    step = max(1, len(model.points) // 400)
    left_ns = end_ns if pushed_ns is None else min(pushed_ns, end_ns)
    in_hand = _in_hand(trial, sightings, end_ns)
    at = {s.t_ns: s for s in sightings}
    out = []
    last: tuple[int, Array] | None = None
    for s in seen:
        if (end_ns - s.t_ns) * 1e-9 > WINDOW_BEFORE_S:
            continue
        by: KnownBy = "path"
        T, sd = path.at(s.t_ns), None
        palm = trial.robot.T_base_palm(s.t_ns)
        if s.t_ns <= left_ns:
            sd = path.sd_at(s.t_ns)
        elif s.t_ns in at:
            T, by = at[s.t_ns].T_base_model, at[s.t_ns].by
            last = s.t_ns, T
        elif in_hand is not None and palm is not None and s.t_ns > in_hand[0]:
            T, by = palm @ in_hand[1], "hand"
        elif last is not None and s.t_ns <= end_ns:
            T, by = last[1].copy(), "support"
            T[:3, 3] += path.velocity[-1] * (s.t_ns - last[0]) * 1e-9
        else:
            continue  # closing fingers may have taken it anywhere
        near = hand_distance(trial, s.t_ns, transform(T, model.points[::step]))
        out.append(Moment(s.index, s.t_ns, T, by, sd, *(near or (None, None))))
    return tuple(out)


def _in_hand(trial: Trial, sightings: list[Sighting], end_ns: int) -> tuple[int, Array] | None:
    """From when on, and T_palm_model, if the object was seen to move with the palm while that rose; None else."""
    then = trial.robot.T_base_palm(end_ns)
    after = [(s, palm) for s in sightings if s.t_ns > end_ns and (palm := trial.robot.T_base_palm(s.t_ns)) is not None]
    risen = [(s, palm) for s, palm in after if then is not None and np.linalg.norm(palm[:3, 3] - then[:3, 3]) > RISEN_M]
    if len(risen) < 3:
        return None
    held = [invert(palm) @ s.T_base_model for s, palm in risen]
    typical = held[int(np.argmin([np.median([np.linalg.norm(a[:3, 3] - b[:3, 3]) for b in held]) for a in held]))]
    if float(np.median([np.linalg.norm(T[:3, 3] - typical[:3, 3]) for T in held])) > HELD_M:
        return None
    # back to the first sighting after the close from which on it lay so in the hand
    with_it = [s.t_ns for s, palm in after if np.linalg.norm((invert(palm) @ s.T_base_model)[:3, 3] - typical[:3, 3]) < HELD_M]
    return with_it[0], typical


def _priors(t_ns: int, path: Path, sightings: list[Sighting], trial: Trial, end_ns: int) -> list[Array]:
    """Where the model may be at a time, T_base_model: on its path; in the hand, after the close; where it was seen last
    (forward) or will be seen next (backward), as after a push, moved with what it stands on."""
    out = [path.at(t_ns)]
    palm, palm_then = trial.robot.T_base_palm(t_ns), trial.robot.T_base_palm(end_ns)
    if t_ns > end_ns and palm is not None and palm_then is not None:
        out.append(palm @ invert(palm_then) @ path.at(end_ns))
    at = bisect_left(sightings, t_ns, key=lambda s: s.t_ns)
    centre = np.append(path.centroid, 1.0)
    for s in (*sightings[max(at - 1, 0) : at], *sightings[at : at + 1]):
        T = s.T_base_model.copy()
        T[:3, 3] += path.velocity[-1] * (t_ns - s.t_ns) * 1e-9
        if abs(t_ns - s.t_ns) * 1e-9 < CARRIED_S and all(np.linalg.norm((T - P) @ centre) > APART_M for P in out):
            out.append(T)
    return out


def _look(
    frame: Frame, seen: Seen, tracker: ModelTracker, model: Model, priors: list[Array], config: Config
) -> Sighting | None:
    """The model in one frame, from each place it may be at; depth needs the gate's fitness, colour enough features."""
    T_camera_base = invert(seen.T_base_camera)
    for prior in priors:
        tracked = tracker.look(frame, model, T_camera_base @ prior)
        if tracked.state != "tracked" or tracked.T_camera_model is None:
            continue
        T = tracked.T_camera_model
        n_features = 0 if tracked.features is None else len(tracked.features.points)
        if tracked.mask is not None and tracked.window is not None and tracked.mask_area >= config.observation.min_points:
            v, u = np.nonzero(tracked.mask)
            step = max(1, len(v) // config.observation.max_points)
            u, v = u[::step] + tracked.window[0], v[::step] + tracked.window[1]
            z = frame.depth[v, u].astype(np.float64)
            points = frame.camera.backproject(u.astype(float), v.astype(float), z)[z > 0]
            result = register(
                Observation(points, np.zeros_like(points)), model, T, tracked.features, frame.camera, config.registration
            )
            if result.reject_reason is None and result.gate_fitness > config.registration.c_a_f:
                return Sighting(frame.t_ns, seen.T_base_camera @ result.T_camera_model, "registration", True)
        if n_features >= MIN_COLOUR:
            return Sighting(frame.t_ns, seen.T_base_camera @ T, "colour", True)
    return None


def blind_gap(sighted_ns: list[int], close_ns: int | None) -> tuple[float | None, GapSided]:
    """Seconds from the last sighting to the close, and whether sightings follow; none of up to NO_GAP_S."""
    if close_ns is None:
        return None, "none"
    before = [t for t in sighted_ns if t <= close_ns]
    after = [t for t in sighted_ns if t > close_ns]
    gap = (close_ns - before[-1]) * 1e-9 if before else float("inf")
    if gap <= NO_GAP_S:
        return gap, "none"
    return gap, "two" if after else "one"
