"""The review recording of a trial for the Rerun viewer; it opens at the decisive moment.

Only this module and compare/review.py call rerun, whose API changes with every release. Colour
images go in as they were recorded where they are JPEG or PNG.
"""

from __future__ import annotations

import hashlib
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dgeval.config import ReviewConfig
from dgeval.geometry import Array, transform
from dgeval.hindsight.moments import nearest_link
from dgeval.hindsight.second_pass import Hindsight
from dgeval.perception.self_filter import Hand
from dgeval.recording.contract import CLOSE_EVENT
from dgeval.recording.trials import Trial
from dgeval.replay.causal import Step
from dgeval.robots.description import LinkShape
from dgeval.verdict.judge import Judgement

TIMELINE = "time"
# The viewer can't be given a moment to open at, but it opens at the end of a timeline that it
# follows. So the last seconds up to the decisive moment, which is known only at the end of the
# replay, are logged again on a second timeline, and the viewer follows that one.
DECISIVE = "up to the decisive moment"
EYE = np.array([0.1, -0.40, 0.25])  # m, base axes: place of the viewer's eye from its target
BEFORE_S = 2.0  # s, length of the second timeline
EVERY = 3  # every n-th frame is on it
KEPT = 400  # frames kept in memory, of which it is made
# RGB
OBJECT, HAND, GRASP, OFFENDING = (240, 170, 40), (120, 130, 145), (60, 180, 90), (230, 40, 40)
STATES = {"tracked": "tracked", "lost": "lost", "not_started": "not started"}


@dataclass(frozen=True)
class _Moment:
    """The parts of a frame that are drawn again on the second timeline."""

    t_ns: int
    image: rr.EncodedImage
    box: rr.Boxes2D | None
    hand: Hand | None
    T_base_camera: Array
    T_base_model: Array | None
    row: dict[str, Any]


class ReviewWriter:
    """Writes one trial's `.rrd` frame by frame.

    `close` adds hindsight and blueprint, and moves the file to its final path.
    """

    def __init__(self, path: Path, trial: Trial, config: ReviewConfig) -> None:
        self._path, self._robot, self._config = path, trial.robot, config
        self._close_ns = trial.event_ns(CLOSE_EVENT)
        self._start_ns = trial.pairs[0][0]
        self._rec = rr.RecordingStream(
            "dgeval",
            recording_id=trial.spec.id,
            send_properties=False,
            batcher_config=rr.ChunkBatcherConfig.NEVER(),
        )
        self._rec.set_log_time_enabled(False)
        self._rec.set_log_tick_enabled(False)
        self._rec.save(path)
        self._moments: deque[_Moment] = deque(maxlen=KEPT)
        self._drawn: set[str] = set()
        self._state: str | None = None
        self._model_size = -1
        self._first_lost_ns: int | None = None
        self._was_tracked = False
        self._image_bytes = 0
        k = trial.camera
        self._rec.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._rec.log(
            "world/camera",
            rr.Pinhole(
                focal_length=(k.fx, k.fy),
                principal_point=(k.cx, k.cy),
                width=k.width,
                height=k.height,
                image_plane_distance=0.12,
            ),
            static=True,
        )
        for entity, names in SERIES.items():
            self._rec.log(entity, rr.SeriesLines(names=list(names)), static=True)
        for event in trial.events:
            self._at(event.t_ns)
            self._rec.log("events", rr.TextLog(f"{event.kind} {event.fields or ''}".strip()))

    def _at(self, t_ns: int) -> None:
        self._rec.set_time(TIMELINE, duration=(t_ns - self._start_ns) * 1e-9)

    def add(self, step: Step) -> None:
        """Log one frame: image with box, mask and projected model; scene; plots; tracker state."""
        frame, state, row, rec = step.frame, step.tracked.state, step.row, self._rec
        self._at(frame.t_ns)
        image, box = self._log_images(step)
        T_base_camera = frame.T_base_camera if frame.T_base_camera is not None else np.eye(4)
        rec.log("world/camera", _transform(T_base_camera))
        if state != self._state:
            self._state = state
            rec.log("phase/tracking", rr.StateChange(state=STATES[state]))
        if state == "tracked":
            self._was_tracked = True
        elif self._was_tracked and self._first_lost_ns is None:
            self._first_lost_ns = frame.t_ns
        if frame.hand is not None:
            self._log_hand(frame.hand, T_base_camera)
        if step.model is not None and step.T_camera_model is not None:
            T = T_base_camera @ step.T_camera_model
            rec.log("world/object", _transform(T))
            if (
                abs(len(step.model.points) - self._model_size) > 0.05 * max(self._model_size, 1)
                or frame.index % 30 == 0
            ):
                self._model_size = len(step.model.points)
                every = max(1, self._model_size // self._config.cloud_points)
                rec.log(
                    "world/object/model",
                    rr.Points3D(
                        step.model.points[::every].astype(np.float32), radii=0.001, colors=OBJECT
                    ),
                )
        estimate = step.perceived.estimate
        if estimate is not None:
            v, at = [estimate.velocity.tolist()], [estimate.position.tolist()]
            rec.log(
                "world/velocity", rr.Arrows3D(vectors=v, origins=at, colors=OBJECT, radii=0.002)
            )
        if row.get("grasp_px") is not None:
            self._log_axes("world/grasp", row, "grasp", GRASP)
        if row.get("hand_px") is not None:
            self._log_axes("world/palm", row, "hand", HAND)
        self._log_series(row)
        if self._close_ns is None or frame.t_ns <= self._close_ns:
            T_base_model = (
                None if step.T_camera_model is None else T_base_camera @ step.T_camera_model
            )
            self._moments.append(
                _Moment(frame.t_ns, image, box, frame.hand, T_base_camera, T_base_model, row)
            )

    def _log_series(self, row: dict[str, Any]) -> None:
        for entity, names in SERIES.items():
            values = [row.get(name) for name in names.values()]
            if any(v is not None for v in values):
                self._rec.log(
                    entity, rr.Scalars([np.nan if v is None else float(v) for v in values])
                )

    def _log_images(self, step: Step) -> tuple[rr.EncodedImage, rr.Boxes2D | None]:
        frame, rec = step.frame, self._rec
        image = "world/camera/colour"
        data = frame.colour_file
        if data is None:
            quality = [cv2.IMWRITE_JPEG_QUALITY, self._config.jpeg_quality]
            data = cv2.imencode(".jpg", frame.colour[:, :, ::-1], quality)[1].tobytes()
        encoded = rr.EncodedImage(
            contents=data, media_type="image/png" if data[:4] == b"\x89PNG" else "image/jpeg"
        )
        rec.log(image, encoded)
        self._image_bytes += len(data)
        if frame.index % self._config.depth_every == 0:
            # half size: depth is here for display only
            small = np.clip(frame.depth[::2, ::2] * 1000, 0, 65535).astype(np.uint16)
            png = cv2.imencode(".png", small)[1].tobytes()
            rec.log(
                "depth",
                rr.EncodedDepthImage(
                    png, media_type="image/png", meter=1000.0, depth_range=(200, 2000)
                ),
            )
        if step.tracked.box is None:
            rec.log(f"{image}/box", rr.Clear(recursive=False))
            rec.log(f"{image}/mask", rr.Clear(recursive=False))
            rec.log(f"{image}/model", rr.Clear(recursive=False))
            return encoded, None
        x0, y0, x1, y1 = step.tracked.box
        colour = OBJECT if step.accepted else (220, 60, 50)
        drawn = rr.Boxes2D(array=[x0, y0, x1, y1], array_format=rr.Box2DFormat.XYXY, colors=colour)
        rec.log(f"{image}/box", drawn)
        if step.tracked.mask is not None and step.tracked.window is not None:
            contours = cv2.findContours(
                step.tracked.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1
            )[0]
            corner = np.array(step.tracked.window[:2])
            strips = [np.vstack([c[:, 0], c[:1, 0]]) + corner for c in contours if len(c) > 4]
            rec.log(f"{image}/mask", rr.LineStrips2D(strips, colors=(230, 60, 200), radii=0.7))
        if step.model is not None and step.T_camera_model is not None:
            points = transform(
                step.T_camera_model, step.model.points[:: max(1, len(step.model.points) // 250)]
            )
            points = points[points[:, 2] > 0.05]
            rec.log(
                f"{image}/model",
                rr.Points2D(
                    frame.camera.project(points).astype(np.float32),
                    colors=(80, 200, 255),
                    radii=0.8,
                ),
            )
        return encoded, drawn

    def _log_hand(self, hand: Hand, T_base_camera: Array) -> None:
        for i, (shape, T_camera_shape) in enumerate(hand):
            entity = f"world/hand/{shape.link}/{i}"
            self._rec.log(entity, _transform(T_base_camera @ T_camera_shape))
            drawn = _solid(shape)
            if drawn is not None and entity not in self._drawn:
                self._drawn.add(entity)
                self._rec.log(entity, drawn, static=True)

    def _log_axes(
        self, entity: str, row: dict[str, Any], prefix: str, colour: tuple[int, int, int]
    ) -> None:
        at = [row[f"{prefix}_p{a}"] for a in "xyz"]
        q = [row[f"{prefix}_q{a}"] for a in "xyzw"]
        self._rec.log(entity, rr.Transform3D(translation=at, quaternion=q))
        if entity not in self._drawn:
            self._drawn.add(entity)
            axes = rr.Arrows3D(
                vectors=0.05 * np.eye(3),
                colors=[(220, 60, 60), colour, (60, 90, 220)],
                radii=0.0015,
            )
            self._rec.log(f"{entity}/axes", axes, static=True)

    def close(
        self, path: Path, hindsight: Hindsight | None, judgement: Judgement
    ) -> dict[str, int]:
        """Add hindsight and blueprint, and move the file to `path`.

        Returns the bytes of the file and of the colour images in it.
        """
        known = decisive = judgement.decisive_ns or self._first_lost_ns
        evidence = judgement.row.evidence
        if decisive is None and self._moments:
            decisive = self._moments[-1].t_ns
        if hindsight is not None:
            self._log_hindsight(hindsight, decisive)
            if known is not None:
                self._log_nearest(hindsight, judgement.link, known)
        if decisive is not None:
            self._at(decisive)
            self._rec.log(
                "events",
                rr.TextLog(
                    f"decisive moment: {evidence}; timeline `{TIMELINE}` goes on", level="WARN"
                ),
            )
            self._rec.reset_time()
            self._log_decisive(decisive, evidence)
        target = None
        if hindsight is not None and decisive is not None:
            target = transform(hindsight.path.at(decisive), hindsight.path.centroid[None])[0]
        self._rec.send_blueprint(_blueprint(target))
        self._rec.flush()
        self._rec.disconnect()
        self._path.replace(path)
        return {"bytes": path.stat().st_size, "image_bytes": self._image_bytes}

    def _log_hindsight(self, hindsight: Hindsight, ends_ns: int | None) -> None:
        """Log the undisturbed path, the observations of the object, and its distance from the hand.

        ends_ns: where the timeline DECISIVE ends, which shows that distance too.
        """
        rec = self._rec
        times = [m.t_ns for m in self._moments] or [s.t_ns for s in hindsight.sightings]
        centres = [transform(hindsight.path.at(t), hindsight.path.centroid[None])[0] for t in times]
        rec.log(
            "world/hindsight/free_path",
            rr.LineStrips3D([centres], colors=OBJECT, radii=0.001),
            static=True,
        )
        observed = [
            transform(s.T_base_model, hindsight.path.centroid[None])[0] for s in hindsight.sightings
        ]
        rec.log(
            "world/hindsight/sightings",
            rr.Points3D(observed, colors=(90, 160, 250), radii=0.002),
            static=True,
        )
        for m in hindsight.moments:
            if m.distance is None:
                continue
            rec.reset_time()
            self._at(m.t_ns)
            if ends_ns is not None and ends_ns - BEFORE_S * 1e9 <= m.t_ns <= ends_ns:
                rec.set_time(DECISIVE, duration=(m.t_ns - self._start_ns) * 1e-9)
            rec.log("plots/distance", rr.Scalars(1000 * m.distance))
        rec.reset_time()

    def _log_nearest(self, hindsight: Hindsight, link: str | None, decisive_ns: int) -> None:
        """Log the object at the decisive moment, the nearest link and its distance from it."""
        rec = self._rec
        step = max(1, len(hindsight.points) // self._config.cloud_points)
        points = transform(hindsight.path.at(decisive_ns), hindsight.points[::step])
        rec.log(
            "world/hindsight/object",
            rr.Points3D(points.astype(np.float32), radii=0.001, colors=OFFENDING),
            static=True,
        )
        near = nearest_link(self._robot, decisive_ns, points, link)
        if near is not None:
            name, distance, a, b = near
            label = f"{name}: {distance * 1000:.0f} mm"
            line = rr.LineStrips3D([[a, b]], colors=OFFENDING, radii=0.002, labels=label)
            rec.log("world/hindsight/distance", line, static=True)

    def _log_decisive(self, decisive_ns: int, evidence: str) -> None:
        """Log the last BEFORE_S s up to the decisive moment again, on the timeline DECISIVE."""
        rec = self._rec
        moments = [
            moment
            for moment in self._moments
            if decisive_ns - BEFORE_S * 1e9 <= moment.t_ns <= decisive_ns
        ] or list(self._moments)[-1:]
        for moment in moments[::-EVERY][::-1]:
            rec.set_time(DECISIVE, duration=(moment.t_ns - self._start_ns) * 1e-9)
            rec.log("world/camera/colour", moment.image)
            rec.log(
                "world/camera/colour/box",
                rr.Clear(recursive=False) if moment.box is None else moment.box,
            )
            rec.log("world/camera", _transform(moment.T_base_camera))
            if moment.hand is not None:
                self._log_hand(moment.hand, moment.T_base_camera)
            if moment.T_base_model is not None:
                rec.log("world/object", _transform(moment.T_base_model))
            self._log_series(moment.row)
            rec.log("phase/tracking", rr.StateChange(state=STATES[moment.row["tracking"]]))
        rec.log("events", rr.TextLog(evidence, level="WARN"))


# Plots: entity, then legend and column of the frame table of each line
SERIES: dict[str, dict[str, str]] = {
    "plots/error": {"linear, m": "error_linear", "angular, rad": "error_angular"},
    "plots/velocity": {"v x": "velocity_x", "v y": "velocity_y", "v z": "velocity_z"},
    "plots/score": {"hand": "hand_score", "grasp": "grasp_score"},
    "plots/registration": {"gate fitness": "icp_gate_fitness", "fitness": "icp_fitness"},
}


def _blueprint(target: Array | None) -> rrb.Blueprint:
    """Layout of the views.

    target: point (3,) m in the base frame that the viewer's eye looks at; None: the viewer chooses.
    """
    eye = None
    if target is not None:
        eye = rrb.EyeControls3D(position=target + EYE, look_target=target, eye_up=(0, 0, 1))
    plots = rrb.Vertical(
        rrb.TimeSeriesView(origin="plots/error", name="error hand to grasp"),
        rrb.TimeSeriesView(origin="plots/velocity", name="estimated velocity, m/s"),
        rrb.TimeSeriesView(origin="plots/score", name="score"),
        rrb.TimeSeriesView(origin="plots/distance", name="hand to object by hindsight, mm"),
        rrb.TimeSeriesView(origin="plots/registration", name="registration"),
        rrb.StateTimelineView(origin="phase", name="phase"),
    )
    images = rrb.Vertical(
        rrb.Spatial2DView(
            origin="world/camera",
            contents=["world/camera/colour/**"],
            name="colour: box, mask, model",
        ),
        rrb.Spatial2DView(origin="depth", name="depth"),
        rrb.TextLogView(origin="events", name="events"),
        row_shares=[4, 2, 1],
    )
    scene = rrb.Spatial3DView(
        origin="world",
        contents=["world/**", "- world/camera/colour/**"],
        name="scene, base frame",
        eye_controls=eye,
    )
    return rrb.Blueprint(
        rrb.Horizontal(images, scene, plots, column_shares=[3, 3, 3]),
        rrb.TimePanel(
            timeline=DECISIVE, play_state="following", playback_speed=0.5, state="collapsed"
        ),
        collapse_panels=True,
    )


def _transform(T: Array) -> rr.Transform3D:
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def _solid(shape: LinkShape) -> Any:
    """A link's solid in its own frame; None for a convex hull, which is not drawn."""
    if shape.kind == "box":
        return rr.Boxes3D(half_sizes=[shape.size], colors=HAND, fill_mode="solid")
    if shape.kind == "sphere":
        return rr.Ellipsoids3D(radii=[shape.size[0]], colors=HAND, fill_mode="solid")
    if shape.kind == "cylinder":
        return rr.Cylinders3D(
            lengths=[2 * shape.size[1]], radii=[shape.size[0]], colors=HAND, fill_mode="solid"
        )
    if shape.kind == "capsule":
        half = shape.size[1]
        return rr.Capsules3D(
            lengths=[2 * half],
            radii=[shape.size[0]],
            translations=[(0, 0, -half)],
            colors=HAND,
            fill_mode="solid",
        )
    return None


def content_digest(path: Path) -> str:
    """SHA-256 over the data of an `.rrd`.

    Without the row ids, which rerun draws anew for every file.
    """
    from rerun.chunk import RrdReader

    parts = []
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        names = sorted(
            n for n in batch.schema.names if "RowId" not in n and n != "rerun.controls.RowId"
        )
        columns = [f"{n}:{batch.column(n).to_pylist()!r}" for n in names]
        parts.append(f"{chunk.entity_path}|" + "|".join(columns))
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()
