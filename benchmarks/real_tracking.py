"""Tracking on real recordings with truth, beside OpenCV's CSRT on the same images.

The recordings lie below the folder that DGEVAL_REAL_DATA names, each in a folder with a truth.json;
box overlap counts a frame without a box as 0. CSRT starts from five boxes, moved by up to 1 px.
Beside another version of dgeval: run it there with --json, and give its file with --before.

    python -m benchmarks.real_tracking
    python -m benchmarks.real_tracking --json before.json     (in a clone of the other version)
    python -m benchmarks.real_tracking --before before.json --pictures runs/real_tracking
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from dgeval import api
from dgeval.config import load_config
from dgeval.determinism import limit_threads
from dgeval.geometry import Array, Box
from dgeval.perception.boxes import overlap
from dgeval.perception.pipeline import Perception
from dgeval.recording.frame import Frame
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.trials import Trial, open_trial

from benchmarks import result

SHIFTS = ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1))  # px, of CSRT's first boxes
SURE, GOOD, RIGHT = 0.8, 0.7, 0.5  # confidence and overlaps that the report counts
HEAD = (
    "recording", "frames", "tracker", "IoU mean", "IoU p10", "lost", "to the end", "accepted",
    "centre, mm median", "drift, mm median / p95", "sure and right", "good and sure", "ms a frame",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One tracker on one recording; centre and drift in mm, None where there is no truth of them.

    sure_right: share of the frames of confidence over SURE with an overlap over RIGHT. good_sure:
    of those with an overlap over GOOD the share of confidence over SURE.
    """

    recording: str
    frames: int
    tracker: str
    iou: float
    iou_p10: float
    lost: int
    to_the_end: int
    accepted: int | None
    centre_mm: float | None
    drift_mm: tuple[float, float] | None
    sure_right: float | None
    good_sure: float | None
    ms: float

    def cells(self) -> list[str]:
        """For the table."""
        drift = "–" if self.drift_mm is None else " / ".join(f"{v:.1f}" for v in self.drift_mm)
        shares = ["–" if s is None else f"{s:.2f}" for s in (self.sure_right, self.good_sure)]
        accepted = "–" if self.accepted is None else str(self.accepted)
        return [
            self.recording, str(self.frames), self.tracker, f"{self.iou:.2f}",
            f"{self.iou_p10:.2f}", str(self.lost), str(self.to_the_end), accepted,
            result.number(self.centre_mm), drift, *shares, f"{self.ms:.0f}",
        ]  # fmt: skip


def recordings() -> list[Path]:
    """The folders below DGEVAL_REAL_DATA with a recording and its truth."""
    root = Path(os.environ.get("DGEVAL_REAL_DATA", ""))
    return sorted(path.parent for path in root.glob("*/truth.json"))


def overlaps(truth: list[dict[str, Any]], boxes: dict[int, Box | None]) -> tuple[list[float], int]:
    """Of the frames in which the target is seen, and how many at the end have no box."""
    out, at_end = [], 0
    for frame in truth:
        if frame["bbox_xyxy"] is None:
            continue
        box = boxes.get(frame["t_ns"])
        at_end = at_end + 1 if box is None else 0
        out.append(0.0 if box is None else overlap(tuple(frame["bbox_xyxy"]), box))
    return out, at_end


def tracked(name: str, trial: Trial, truth: list[dict[str, Any]], pictures: Path | None) -> Row:
    """dgeval's own tracking of one recording."""
    known = {frame["t_ns"]: frame for frame in truth}
    boxes: dict[int, Box | None] = {}
    sure: dict[int, float | None] = {}
    centres, origins, strip = [], [], []
    accepted, frames, seconds = 0, 0, 0.0
    place: Array | None = None  # the middle of the first model, which moves with the target
    perception = Perception(trial.config)
    for step in api.replay_trial(trial, perception):
        frame = known.get(step.frame.t_ns, {})
        frames += 1
        accepted += step.accepted
        seconds += sum(
            v for k, v in step.seconds.items() if k in ("tracking", "registration", "fusion")
        )
        boxes[step.frame.t_ns] = step.tracked.box
        sure[step.frame.t_ns] = getattr(step.tracked, "confidence", None)
        centroid = step.perceived.fused.centroid
        if centroid is not None and frame.get("centre_camera_m") is not None:
            centres.append(np.linalg.norm(centroid - frame["centre_camera_m"]) * 1e3)
        if step.T_camera_model is not None and "scene_T_camera" in frame:
            if place is None and step.model is not None:
                place = step.model.points.mean(axis=0)
            T = np.array(frame["scene_T_camera"]) @ step.T_camera_model
            origins.append(T[:3, :3] @ place + T[:3, 3])
        if pictures is not None and step.frame.index % 10 == 0:
            strip.append(_picture(step.frame, frame.get("bbox_xyxy"), step.tracked.box))
    if pictures is not None:
        _write_strip(pictures / f"{name}.jpg", strip)
    values, at_end = overlaps(truth, boxes)
    said = [
        (value, sure[f["t_ns"]])
        for value, f in zip(values, (f for f in truth if f["bbox_xyxy"] is not None), strict=True)
    ]
    told = [(v, c) for v, c in said if c is not None]
    drift = None
    if origins:
        off = np.linalg.norm(np.array(origins) - np.median(origins, axis=0), axis=1) * 1e3
        drift = float(np.median(off)), float(np.quantile(off, 0.95))
    return Row(
        name, frames, "dgeval", float(np.mean(values)), float(np.quantile(values, 0.1)),
        sum(v == 0.0 for v in values), at_end, accepted,
        float(np.median(centres)) if centres else None, drift,
        _share([v > RIGHT for v, c in told if c > SURE]),
        _share([c > SURE for v, c in told if v > GOOD]), 1e3 * seconds / frames,
    )  # fmt: skip


def _share(values: list[bool]) -> float | None:
    return float(np.mean(values)) if values else None


def csrt(name: str, frames: list[Frame], truth: list[dict[str, Any]]) -> Row:
    """CSRT on colour alone: the mean of all first boxes."""
    first = np.round(truth[0]["bbox_xyxy"]).astype(int)
    values, lost, ends, seconds = [], [], [], 0.0
    for shift in SHIFTS:
        x0, y0, x1, y1 = first + np.array([*shift, *shift])
        tracker: Any = cv2.TrackerCSRT.create()
        boxes: dict[int, Box | None] = {}
        start = time.perf_counter()
        for frame in frames:
            image = np.ascontiguousarray(frame.colour[:, :, ::-1])
            if not boxes:
                tracker.init(image, (int(x0), int(y0), int(x1 - x0), int(y1 - y0)))
                boxes[frame.t_ns] = (float(x0), float(y0), float(x1), float(y1))
                continue
            found, (x, y, w, h) = tracker.update(image)
            boxes[frame.t_ns] = (x, y, x + w, y + h) if found else None
        seconds += time.perf_counter() - start
        run, at_end = overlaps(truth, boxes)
        values.append(run)
        lost.append(sum(v == 0.0 for v in run))
        ends.append(at_end)
    return Row(
        name, len(frames), "CSRT", float(np.mean(values)), float(np.quantile(values, 0.1)),
        round(np.mean(lost)), round(np.mean(ends)), None, None, None, None, None,
        1e3 * seconds / len(frames) / len(SHIFTS),
    )  # fmt: skip


def _picture(frame: Frame, truth: list[float] | None, box: Box | None) -> Array:
    image = np.ascontiguousarray(frame.colour[:, :, ::-1])
    for corners, colour in ((truth, (0, 200, 0)), (box, (0, 0, 230))):
        if corners is not None:
            x0, y0, x1, y1 = (round(v) for v in corners)
            cv2.rectangle(image, (x0, y0), (x1, y1), colour, 2)
    cv2.putText(image, str(frame.index), (6, 24), 0, 0.8, (255, 255, 255), 2)
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5))


def _write_strip(path: Path, pictures: list[Array], wide: int = 5) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    missing = -len(pictures) % wide
    pictures = [*pictures, *[np.zeros_like(pictures[0])] * missing]
    rows = [np.hstack(pictures[k : k + wide]) for k in range(0, len(pictures), wide)]
    cv2.imwrite(str(path), np.vstack(rows))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, help="write the rows there, and no table")
    parser.add_argument("--before", type=Path, help="rows of another version")
    parser.add_argument("--pictures", type=Path, help="folder for a strip of each recording")
    options = parser.parse_args()
    if not os.environ.get("DGEVAL_REAL_DATA"):
        parser.error("DGEVAL_REAL_DATA names no folder of recordings")
    limit_threads()
    rows = []
    for folder in recordings():
        truth = json.loads((folder / "truth.json").read_text())["frames"]
        recording = next(p for p in sorted(folder.iterdir()) if p.is_dir())
        config = load_config("dynamic", ("grasps.source=none",))
        x0, y0, x1, y1 = (float(v) for v in truth[0]["bbox_xyxy"])
        trial = open_trial(TrialSpec(folder.name, recording, bbox=(x0, y0, x1, y1)), config)
        rows.append(tracked(folder.name, trial, truth, options.pictures))
        if options.json is None:
            rows.append(csrt(folder.name, list(trial.frames()), truth))
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(row) for row in rows]))
        return
    if options.before is not None:
        before = [
            Row(**{**row, "tracker": "before"}) for row in json.loads(options.before.read_text())
        ]
        rows = sorted([*rows, *before], key=lambda row: row.recording)
    text = (
        "Box overlap with truth where the target is seen; a frame without a box counts 0. lost: "
        "frames without overlap. Sure and right: of the frames of confidence over "
        f"{SURE} the share with an overlap over {RIGHT}; good and sure: of those with an overlap "
        f"over {GOOD} the share of confidence over {SURE}. ms: tracking, registration and fusion "
        "(CSRT: update), wall time. Drift: in the scene, of the point of the target that was the "
        "middle of its first model, of a target that rests, from its median place. No truth of "
        "these recordings was fitted to, but thresholds were chosen while "
        "looking at both."
    )
    result.write(
        "real_tracking",
        "Tracking on real recordings",
        "python -m benchmarks.real_tracking",
        [text, result.table(HEAD, [row.cells() for row in rows])],
    )


if __name__ == "__main__":
    main()
