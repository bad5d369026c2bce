"""Does the modelled cloud smear and forget as the model of a rendered recording does?

`python -m benchmarks.modelled_cloud [MANIFEST]`

Of each recording the causal pass gives the fused model in every frame. The modelled cloud of
`simulation.perception` goes along the same true poses, accepted in the same frames. Both are held
against the object's true surface: how far their points lie from it, how much of it they have held,
and of what they held and the camera has not seen for 0.5 s, how much they hold still.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.config import Config, load_config
from dgeval.determinism import generator, limit_threads
from dgeval.geometry import Array, increment, invert, matrix_from_pose, transform
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.recording.messages import poses_of
from dgeval.recording.trials import open_trial
from dgeval.replay.causal import replay
from dgeval.simulation.clouds import seen_from
from dgeval.simulation.perception import ModelledCloud
from dgeval.simulation.scenario import PerceptionNoise
from dgeval.worlds.objects import surface_points, ten_objects
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.result import number, table, write

SMOKE = Path("datasets/ci-smoke/ci-smoke.toml")
LONG_AGO_S, HELD_M, LEAST_POINTS = 0.5, 0.006, 50
SIZES = (512, 1024, 4096)


class Clouds:
    """What one model is, frame by frame, beside the surface. In the true object frame.

    off: median distance of its points, m. ever: share of the surface that it has held. held: of
    what it once held, and the camera has not seen for LONG_AGO_S, the share that it still holds.
    """

    def __init__(self, surface: Array) -> None:
        self._surface, self._tree = surface, KDTree(surface)
        self._once = np.zeros(len(surface), bool)
        self.off: list[float] = []
        self.ever: list[float] = []
        self.held: list[float] = []

    def add(self, model: Array, out_of_view: NDArray[np.bool_]) -> None:
        now = KDTree(model).query(self._surface)[0] < HELD_M
        self._once |= now
        self.off.append(float(np.median(self._tree.query(model)[0])))
        self.ever.append(float(self._once.mean()))
        gone = self._once & out_of_view
        if gone.sum() > LEAST_POINTS:
            self.held.append(float(now[gone].mean()))


def truth_of(trial: Any) -> dict[int, Array]:
    """T_base_object by time, ns."""
    out = {}
    for message in trial.opened.messages(frozenset({"/truth/object_pose"})):
        out[message.log_ns] = matrix_from_pose(poses_of(trial.opened.decode(message))[0].pose)
    return out


def frames_of(spec: TrialSpec, config: Config) -> Iterator[tuple[int, Array, Array]]:
    """Time ns, T_camera_object true, and the model, camera frame, while accepted."""
    trial = open_trial(spec, config)
    truth, end_ns = truth_of(trial), trial.event_ns("close")
    for step in replay(trial, config):
        t_ns, T = step.frame.t_ns, step.T_base_camera
        if end_ns is not None and t_ns > end_ns:
            return
        if T is None or not step.accepted or t_ns not in truth or step.model is None:
            continue
        assert step.T_camera_model is not None
        yield t_ns, invert(T) @ truth[t_ns], transform(step.T_camera_model, step.model.points)


def compared(spec: TrialSpec, size: int) -> tuple[Clouds, Clouds]:
    """The real model and the modelled cloud of one recording, with N_max = size."""
    config = load_config("dynamic", ("grasps.source=none", f"fusion.max_model_points={size}"))
    target = ten_objects()[spec.object or ""]
    points = surface_points(target, 8000, generator(0, "truth", 0))
    plan: Any = type("Plan", (), {"seed": 0, "index": 0, "presenter": None})
    camera = open_trial(spec, config).camera
    modelled, noise = ModelledCloud(target, camera, config, plan), PerceptionNoise()
    real, made = Clouds(points), Clouds(points)
    last_seen = np.full(len(points), -np.inf)
    for k, (t_ns, T_camera_object, model) in enumerate(frames_of(spec, config)):
        rng = generator(0, "noise", k)
        error = np.append(
            rng.normal(0, noise.position, 3), np.radians(rng.normal(0, noise.angle, 3))
        )
        believed = T_camera_object @ increment(error)
        cloud = modelled.step(k, T_camera_object, believed)
        assert cloud is not None
        rows, _ = seen_from(points, T_camera_object, rng)
        last_seen[rows] = t_ns
        out = t_ns - last_seen > LONG_AGO_S * 1e9
        # both where they lie in the world: the model's pose error is part of what the hand meets
        real.add(transform(invert(T_camera_object), model), out)
        made.add(transform(invert(T_camera_object) @ believed, cloud), out)
    return real, made


def cell(values: list[float], factor: float, digits: int) -> str:
    return number(factor * float(np.median(values)), digits) if values else "–"


def main() -> None:
    limit_threads()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("manifest", nargs="?", type=Path, default=SMOKE)
    options = parser.parse_args()
    parts = [
        "Medians over the frames up to the close (held once: at the last): distance of the points "
        f"from the true surface; share of it that has had a point within {HELD_M * 1e3:.0f} mm; of "
        f"that, where the camera has not seen it for {LONG_AGO_S:g} s, the share with one still. "
        "Real: the pipeline's model of the recorded images."
    ]
    for size in SIZES:
        rows = []
        for spec in find_trials([options.manifest]):
            real, made = compared(spec, size)
            rows.append(
                [
                    spec.id,
                    cell(real.off, 1e3, 2),
                    cell(made.off, 1e3, 2),
                    cell(real.ever[-1:], 100, 0),
                    cell(made.ever[-1:], 100, 0),
                    cell(real.held, 100, 0),
                    cell(made.held, 100, 0),
                ]
            )
            print(size, rows[-1], flush=True)
        pairs = ("off mm", "held once %", "held still %")
        head = ["trial", *(f"{of}, {what}" for what in pairs for of in ("real", "modelled"))]
        parts += [f"N_max = {size}:", table(head, rows)]
    command = f"python -m benchmarks.modelled_cloud {options.manifest.name}"
    print(write("modelled-cloud", "The modelled cloud", command, parts).read_text())


if __name__ == "__main__":
    main()
