"""The second pass over a log, which may use later frames for earlier ones.

The final model is searched for in every frame around the close in which the causal pass did not
have it, starting from where the smoothed path predicts it. The sightings of both passes are
smoothed together up to the first contact. After that the object's free path is extrapolated, and
sightings say what it really did. Nothing here reads the truth or the robot's beliefs.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dgeval.config import Config
from dgeval.failure_rule import NEAR_M
from dgeval.geometry import Array, invert
from dgeval.hindsight.free_path import free_path
from dgeval.hindsight.moments import (
    WINDOW_AFTER_S,
    WINDOW_BEFORE_S,
    Moment,
    moments_of,
    nearest_approach,
)
from dgeval.hindsight.smoothing import Path, Sighting
from dgeval.hindsight.surface import CausalFrame, Surface
from dgeval.perception.depth_noise import DepthNoise
from dgeval.perception.pipeline import Perception
from dgeval.perception.plane import Plane
from dgeval.perception.registration import register
from dgeval.perception.trackers.model import ModelTracker
from dgeval.perception.types import Model, Observation
from dgeval.recording.contract import CLOSE_EVENT, GRASP_TOPIC
from dgeval.recording.frame import Frame
from dgeval.recording.robot import RobotStates
from dgeval.recording.trials import Trial

GapSided = Literal["none", "one", "two"]
CONTACT_M = 0.006  # m; a hand this near may touch: measured clouds are not more exact
NO_GAP_S = 0.1  # s; from the last sighting to the close, up to which there is no blind gap
MIN_COLOUR = 12  # features that a sighting by colour needs
CARRIED_S = 1.0  # s; a sighting is a prior for frames up to this far away in time
APART_M = 0.01  # m; a prior nearer than this to another one is left out
MOST_MISSED = 45  # frames kept for the search backwards
BACKWARD_NS = 250_000_000  # ns; longest step from a frame to the one before it, going backwards


@dataclass(frozen=True)
class Hindsight:
    """What the whole log says about the object.

    points: of the final model, (n, 3) m, model frame. support: the plane it stands on, base frame.
    contact_ns, contact_link: when, up to the close, the hand was first within CONTACT_M of the
    object, and which link. pushed_ns: when sightings left the free path with the hand near.
    n_registered: sightings by an accepted registration up to the close. gap_s: from the last
    sighting to the close; None without a close. nearest_m: how near the hand came, m, without a
    close; None with one, or where it is not known. moments: by frame, from WINDOW_BEFORE_S before
    the close on; empty without a grasp attempt.
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
    nearest_m: float | None = None


def look_back(
    trial: Trial,
    frames: list[CausalFrame],
    surface: Surface,
    perception: Perception,
    config: Config,
) -> Hindsight | None:
    """The second pass over one trial.

    frames: of the causal pass; surface: what it ever accepted of the object. None where it
    had neither a model nor an accepted pose to start from.
    """
    model = surface.model()
    accepted = [s for s in frames if s.T_camera_model is not None]
    if model is None or not accepted:
        return None
    centroid = model.points.mean(axis=0)
    sightings = _causal(frames, config.observation.min_points)
    end_ns = trial.event_ns(CLOSE_EVENT) or frames[-1].t_ns
    path, _ = free_path(trial.robot, sightings, model, centroid, end_ns)
    support = _support(frames)

    tracker = (
        perception.tracker if isinstance(perception.tracker, ModelTracker) else ModelTracker(config)
    )
    known = {s.t_ns for s in sightings}
    # only a trial with an attempt has a verdict that needs more sightings
    attempt = trial.event_ns(CLOSE_EVENT) is not None or bool(trial.scan.poses.get(GRASP_TOPIC))
    if not attempt:
        near = nearest_approach(trial.robot, frames[0].t_ns, frames[-1].t_ns, path, model.points)
        attempt = near is None or near < NEAR_M
    wanted = {
        s.index: s
        for s in frames
        if attempt
        and s.t_ns not in known
        and -WINDOW_BEFORE_S <= (s.t_ns - end_ns) * 1e-9 <= WINDOW_AFTER_S
    }
    missed: deque[Frame] = deque(maxlen=MOST_MISSED)
    for frame in trial.frames() if wanted else ():
        if frame.index not in wanted:
            continue
        here: Frame | None = frame
        while here is not None:
            # once it has a sighting again, the frames before are searched backwards up to a miss
            priors = _priors(here.t_ns, path, sightings, trial.robot, end_ns)
            sighting = _look(
                here,
                wanted[here.index],
                tracker,
                model,
                priors,
                config,
                perception.noise,
            )
            if sighting is None:
                if here is frame:
                    missed.append(frame)
                break
            insort(sightings, sighting, key=lambda s: s.t_ns)
            here = missed.pop() if missed and here.t_ns - missed[-1].t_ns < BACKWARD_NS else None
    return hindsight_from(
        trial.robot, frames, sightings, model, support, trial.event_ns(CLOSE_EVENT), attempt
    )


def hindsight_from(
    robot: RobotStates,
    frames: list[CausalFrame],
    sightings: list[Sighting],
    model: Model,
    support: Plane | None,
    close_ns: int | None,
    attempt: bool,
) -> Hindsight:
    """Path, moments, contact and gap from all sightings, in time order.

    frames: of the trial; index and time count. support: base frame. attempt: whether there was
    a close or a grasp in the log; without one there are no moments.
    """
    end_ns = close_ns or frames[-1].t_ns
    path, pushed_ns = free_path(robot, sightings, model, model.points.mean(axis=0), end_ns)
    moments = (
        moments_of(robot, frames, path, sightings, model, pushed_ns, end_ns) if attempt else ()
    )
    contact = next(
        (
            m
            for m in moments
            if m.t_ns <= end_ns and m.distance is not None and m.distance < CONTACT_M
        ),
        None,
    )
    notes = [] if support is not None else ["hindsight: no support plane was seen"]
    gap, sided = blind_gap([s.t_ns for s in sightings], close_ns)
    nearest = (
        nearest_approach(robot, frames[0].t_ns, frames[-1].t_ns, path, model.points)
        if close_ns is None
        else None
    )
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
        nearest,
    )


def _causal(frames: list[CausalFrame], min_points: int) -> list[Sighting]:
    """Sightings of the causal pass: by registration, else by depth, else by colour."""
    out = []
    for s in frames:
        if s.T_camera_model is not None:
            out.append(Sighting(s.t_ns, s.T_base_camera @ s.T_camera_model, "registration"))
        elif s.T_tracked is not None and s.n_depth >= min_points:
            out.append(Sighting(s.t_ns, s.T_base_camera @ s.T_tracked, "depth"))
        elif s.T_tracked is not None and s.n_features >= MIN_COLOUR:
            out.append(Sighting(s.t_ns, s.T_base_camera @ s.T_tracked, "colour"))
    return out


def _support(frames: list[CausalFrame]) -> Plane | None:
    """The plane the object stands on, base frame: the median over the frames; None if unknown."""
    planes = [s.support for s in frames if s.support is not None]
    if not planes:
        return None
    n = np.median([p.n for p in planes], axis=0)
    n /= np.linalg.norm(n)
    near = [p for p in planes if p.n @ n > 0.98]
    if not near:
        return None
    return Plane(n, float(np.median([p.d for p in near])), float(len(near) / len(planes)))


def _priors(
    t_ns: int, path: Path, sightings: list[Sighting], robot: RobotStates, end_ns: int
) -> list[Array]:
    """Where the model may be at a time, as T_base_model, to start the search from.

    On its path; in the hand, after the close; and where the sightings before and after have it,
    moved with what it stands on, as after a push.
    """
    out = [path.at(t_ns)]
    palm, palm_then = robot.T_base_palm(t_ns), robot.T_base_palm(end_ns)
    if t_ns > end_ns and palm is not None and palm_then is not None:
        out.append(palm @ invert(palm_then) @ path.at(end_ns))
    at = bisect_left(sightings, t_ns, key=lambda s: s.t_ns)
    centre = np.append(path.centroid, 1.0)
    for s in (*sightings[max(at - 1, 0) : at], *sightings[at : at + 1]):
        T = s.T_base_model.copy()
        T[:3, 3] += path.velocity[-1] * (t_ns - s.t_ns) * 1e-9
        if abs(t_ns - s.t_ns) * 1e-9 < CARRIED_S and all(
            np.linalg.norm((T - P) @ centre) > APART_M for P in out
        ):
            out.append(T)
    return out


def _look(
    frame: Frame,
    known: CausalFrame,
    tracker: ModelTracker,
    model: Model,
    priors: list[Array],
    config: Config,
    noise: DepthNoise,
) -> Sighting | None:
    """Search for the model in one frame from each prior; None where none leads to it.

    By depth it needs a registration that passes the gate, by colour MIN_COLOUR features. noise: as
    the causal pass measured it.
    """
    observation, registration = config.observation, config.registration
    T_camera_base = invert(known.T_base_camera)
    for prior in priors:
        tracked = tracker.look(frame, model, T_camera_base @ prior)
        if tracked.state != "tracked" or tracked.T_camera_model is None:
            continue
        T = tracked.T_camera_model
        n_features = 0 if tracked.features is None else len(tracked.features.points)
        if (
            tracked.mask is not None
            and tracked.window is not None
            and tracked.mask_area >= observation.min_points
        ):
            v, u = np.nonzero(tracked.mask)
            step = max(1, len(v) // observation.max_points)
            u, v = u[::step] + tracked.window[0], v[::step] + tracked.window[1]
            z = frame.depth[v, u].astype(np.float64)
            points = frame.camera.backproject(u.astype(float), v.astype(float), z)[z > 0]
            result = register(
                Observation(points, np.zeros_like(points)),
                model,
                T,
                tracked.features,
                frame.camera,
                registration,
                noise,
            )
            if result.reject_reason is None and result.gate_fitness > registration.c_a_f:
                return Sighting(
                    frame.t_ns, known.T_base_camera @ result.T_camera_model, "registration"
                )
        if n_features >= MIN_COLOUR:
            return Sighting(frame.t_ns, known.T_base_camera @ T, "colour")
    return None


def blind_gap(sighted_ns: list[int], close_ns: int | None) -> tuple[float | None, GapSided]:
    """Seconds from the last sighting to the close, and whether sightings follow.

    The gap is `none` up to NO_GAP_S, `one`-sided without later sightings, else `two`-sided.
    """
    if close_ns is None:
        return None, "none"
    before = [t for t in sighted_ns if t <= close_ns]
    after = [t for t in sighted_ns if t > close_ns]
    gap = (close_ns - before[-1]) * 1e-9 if before else float("inf")
    if gap <= NO_GAP_S:
        return gap, "none"
    return gap, "two" if after else "one"
