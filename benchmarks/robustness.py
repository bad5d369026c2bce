"""Verdicts on changed recordings of the same trials.

`python -m benchmarks.robustness MANIFEST… [--trial ID…] --work DIR`

Nothing is simulated again. Each recording is rewritten with one change and replayed. Its verdict is
compared with the truth and with the verdict on the unchanged recording.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
from dgeval.config import load_config
from dgeval.determinism import generator, set_thread_variables
from dgeval.geometry import increment, matrix_from_pose
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.recording.write import STORE, McapWriter
from dgeval.report.summary import read_truth
from dgeval.robots.urdf import CAMERA_FRAME
from dgeval.runs.trial_job import replay_trial
from dgeval.simulation.record import COLOUR_TOPIC, DEPTH_TOPIC
from dgeval.simulation.sensors import D435
from mcap.reader import make_reader
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.result import RESULTS, table, write

INFO_TOPIC = "/camera/color/camera_info"
HAND_EYE = np.array([0.003, -0.003, 0.0026, *np.radians([0.6, -0.6, 0.5])])  # 5 mm and 1 degree
DROPPED = 0.10  # share of colour and depth messages
LATE_NS = 30_000_000  # ns
CHANGES = (
    "as recorded",
    "hand-eye off by 5 mm and 1 degree",
    "depth noise doubled",
    "10 % of frames dropped",
    "no efforts",
    "no beliefs",
    "depth stamped 30 ms late",
)


def changed(name: str, topic: str, log_ns: int, value: Any, focal: float) -> Any:
    """One message after a change; None: left out. focal: of the colour camera, px."""
    match name, topic:
        case ("hand-eye off by 5 mm and 1 degree", "/robot_description"):
            return replace(value, data=hand_eye(value.data))
        case ("depth noise doubled", topic) if topic == DEPTH_TOPIC:
            return replace(value, data=noisier(value.data, log_ns, focal))
        case ("10 % of frames dropped", topic) if topic in (COLOUR_TOPIC, DEPTH_TOPIC, INFO_TOPIC):
            return None if generator(0, "dropped", log_ns % 2**31).random() < DROPPED else value
        case ("no efforts", "/joint_states"):
            return replace(value, effort=np.zeros(0))
        case ("no beliefs", topic) if topic.startswith("/dgeval/belief/"):
            return None
        case ("depth stamped 30 ms late", topic) if topic == DEPTH_TOPIC:
            t_ns = value.header.stamp.sec * 10**9 + value.header.stamp.nanosec + LATE_NS
            stamp = replace(value.header.stamp, sec=t_ns // 10**9, nanosec=t_ns % 10**9)
            return replace(value, header=replace(value.header, stamp=stamp))
    return value


def hand_eye(description: str) -> str:
    """The robot description with the camera's pose on the hand changed by HAND_EYE."""
    robot = ElementTree.fromstring(description)
    joint = next(j for j in robot.iter("joint") if j.find("child").attrib["link"] == CAMERA_FRAME)  # type: ignore[union-attr]
    origin = joint.find("origin")
    assert origin is not None
    xyz, rpy = ([float(v) for v in origin.attrib[k].split()] for k in ("xyz", "rpy"))
    T = matrix_from_pose(np.array([*xyz, *Rotation.from_euler("xyz", rpy).as_quat()])) @ increment(
        HAND_EYE
    )
    origin.set("xyz", " ".join(repr(float(v)) for v in T[:3, 3]))
    origin.set(
        "rpy", " ".join(repr(float(v)) for v in Rotation.from_matrix(T[:3, :3]).as_euler("xyz"))
    )
    return ElementTree.tostring(robot, encoding="unicode")


def noisier(data: NDArray[np.uint8], log_ns: int, focal: float) -> NDArray[np.uint8]:
    """Compressed depth with twice the noise of the camera's model.

    The noise is in disparity and correlated over a window, as in the model.
    """
    depth = cv2.imdecode(data[12:], cv2.IMREAD_UNCHANGED)
    smooth = cv2.GaussianBlur(
        generator(0, "noisier", log_ns % 2**31).normal(size=depth.shape), (0, 0), D435.correlation
    )
    # variances add: three times the variance on top of the recorded one gives twice the noise
    smooth *= np.sqrt(3) * D435.subpixel_sigma / smooth.std()
    disparity = focal * D435.baseline / np.maximum(depth * D435.depth_unit, 1e-3) + smooth
    noisy = np.where(
        depth > 0, focal * D435.baseline / np.maximum(disparity, 1e-3) / D435.depth_unit, 0
    )
    png = cv2.imencode(".png", np.clip(np.rint(noisy), 0, 65535).astype(np.uint16))[1].ravel()
    return np.concatenate([data[:12], png])


def rewrite(source: Path, target: Path, name: str) -> None:
    """Write the recording with a change; topics and order stay."""
    focal = 0.0
    with source.open("rb") as stream, McapWriter(target) as writer:
        for schema, channel, m in make_reader(stream).iter_messages():
            assert schema is not None
            value = STORE.deserialize_cdr(m.data, schema.name)
            if channel.topic == INFO_TOPIC:
                focal = float(value.k[0])
            value = changed(name, channel.topic, m.log_time, value, focal)
            if value is not None:
                writer.write(channel.topic, m.log_time, value)


def verdict(job: tuple[TrialSpec, str, Path]) -> dict[str, Any]:
    """Replay one trial's changed recording; returns the row of its verdict."""
    spec, name, work = job
    folder = work / name.replace(" ", "-").replace("%", "percent")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{spec.id}.mcap"
    rewrite(spec.recording, file, name)
    result = replay_trial(
        replace(spec, recording=file, sha256=None), load_config(), folder, None, True
    )
    file.unlink()
    if result.row is None:
        return {
            "trial": spec.id,
            "change": name,
            "outcome": "none",
            "failure_class": None,
            "evidence": "; ".join(result.messages),
        }
    kept = {
        k: result.row[k] for k in ("outcome", "failure_class", "sub_cause", "blame", "evidence")
    }
    return {"trial": spec.id, "change": name, **kept}


def rows_of(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    specs = [s for s in find_trials(options.manifest) if not options.trial or s.id in options.trial]
    set_thread_variables()
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(verdict, [(s, name, options.work) for s in specs for name in CHANGES])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("manifest", type=Path, nargs="+")
    parser.add_argument(
        "--trial", action="append", help="only this one; may be given several times"
    )
    parser.add_argument(
        "--work",
        type=Path,
        required=True,
        help="folder for runs; changed recordings are deleted again",
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--tables", action="store_true", help="only make the table of an earlier run again"
    )
    options = parser.parse_args()
    truth = read_truth(options.manifest)
    options.work.mkdir(parents=True, exist_ok=True)
    kept = options.work / "rows.jsonl"
    if not options.tables:
        with kept.open("w") as file:
            for row in rows_of(options):
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(row["trial"], row["change"], row["outcome"], row["failure_class"], flush=True)
    rows = [json.loads(line) for line in kept.read_text().splitlines()]
    # of a run that was stopped, only the trials with all changes
    complete = {r["trial"] for r in rows if r["change"] == CHANGES[-1]}
    rows = [r for r in rows if r["trial"] in complete]
    before = {r["trial"]: r for r in rows if r["change"] == "as recorded"}
    cells = []
    for name in CHANGES:
        changed_rows = [r for r in rows if r["change"] == name]
        failed = [r for r in changed_rows if truth[r["trial"]]["outcome"] == "failure"]
        outcome = sum(r["outcome"] == truth[r["trial"]]["outcome"] for r in changed_rows)
        right = sum(r["failure_class"] == truth[r["trial"]]["failure_class"] for r in failed)
        unclassified = sum(r["failure_class"] in ("unknown", None) for r in failed)
        reclassified = [
            r for r in failed if r["failure_class"] != before[r["trial"]]["failure_class"]
        ]
        moved = ", ".join(
            f"{r['trial']} {before[r['trial']]['failure_class']} to {r['failure_class']}"
            for r in reclassified
        )
        cells.append(
            [
                name,
                f"{outcome}/{len(changed_rows)}",
                f"{right}/{len(failed)}",
                str(unclassified),
                moved or "–",
            ]
        )
    head = ["recording", "outcome right", "class right", "no class", "other class than as recorded"]
    command = f"python -m benchmarks.robustness {' '.join(p.name for p in options.manifest)}"
    print(
        write(
            "robustness", "Verdicts on changed recordings", command, [table(head, cells)], RESULTS
        ).read_text()
    )


if __name__ == "__main__":
    main()
