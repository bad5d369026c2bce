"""Registration methods and their gate: accuracy, time, determinism, false accepts and rejects.

python -m benchmarks.registration
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dgeval.config import RegistrationConfig
from dgeval.determinism import limit_threads, set_thread_variables
from dgeval.geometry import Array, Intrinsics, invert, rotation_angle
from dgeval.perception.registration import BACKENDS, gate, register
from dgeval.perception.types import Features, Model, Observation

from benchmarks import registration_scenes as scenes
from benchmarks import result

START_M, START_RAD = 0.005, float(np.deg2rad(2.0))  # error of the start pose
WRONG_MM, WRONG_DEG = 5.0, 5.0  # a pose farther off counts as wrong
VIEWS, DRAWS = 4, 5  # views per range and noise draws per view
METHODS: dict[str, tuple[str, bool]] = {
    # name: (backend, with image features)
    **{name: (name, False) for name in BACKENDS},
    "small_gicp + features": ("small_gicp", True),
}
MOVED: dict[str, tuple[float, float]] = {
    # name: (shift m, turn rad about the vertical)
    "turned 45°": (0.0, float(np.deg2rad(45))),
    "turned 90°": (0.0, float(np.deg2rad(90))),
    "shifted 10 mm": (0.010, 0.0),
}


NO_FEATURES = Features(np.zeros((0, 3)), np.zeros((0, 2)))


@dataclass(frozen=True)
class Case:
    """One observation with camera, true pose, start pose (T_camera_model) and image features."""

    observation: Observation
    camera: Intrinsics
    truth: Array
    start: Array
    features: Features


@dataclass(frozen=True)
class Fit:
    """Result of one registration.

    mm, deg: error of the object's centre and of the angle. seconds: of the call. reason: of the
    gate's rejection, None if accepted. fitness: the gate's; wide_fitness: within the search radius.
    """

    mm: float
    deg: float
    seconds: float
    reason: str | None
    fitness: float
    wide_fitness: float


def fit(case: Case, model: Model, method: str, gate_from: Array) -> Fit:
    """Register and gate one case.

    gate_from: T_camera_model one frame (1/30 s) before, from which the gate measures the motion.
    """
    backend, with_features = METHODS[method]
    config = RegistrationConfig(method=backend, colour=with_features)
    start_s = time.perf_counter()
    features = case.features if with_features else None
    registered = register(case.observation, model, case.start, features, case.camera, config)
    seconds = time.perf_counter() - start_s
    reason = gate(registered, gate_from, np.zeros(3), 1 / 30, config)
    mm = float(np.linalg.norm(registered.T_camera_model[:3, 3] - case.truth[:3, 3])) * 1e3
    deg = float(
        np.rad2deg(rotation_angle(registered.T_camera_model[:3, :3].T @ case.truth[:3, :3]))
    )
    return Fit(mm, deg, seconds, reason, registered.gate_fitness, registered.fitness)


def alone(case: Case, model: Model, backend: str) -> tuple[float, float, float]:
    """(error mm, error deg, time ms) of a backend without the refinement that `register` adds."""
    config = RegistrationConfig(method=backend)
    start_s = time.perf_counter()
    T = invert(BACKENDS[backend](case.observation.points, model, invert(case.start), config))
    ms = (time.perf_counter() - start_s) * 1e3
    mm = float(np.linalg.norm(T[:3, 3] - case.truth[:3, 3])) * 1e3
    return mm, float(np.rad2deg(rotation_angle(T[:3, :3].T @ case.truth[:3, :3]))), ms


def first_model(draws: int) -> str:
    """Table of the gate in the second frame, when the model is one observation.

    A model too sparse for its size would never accept a second observation.
    """
    rows = []
    for b, (box, half) in enumerate({**scenes.BOXES, **scenes.LARGE}.items()):
        row = [box]
        for distance in scenes.RANGES:
            rng = np.random.default_rng(1000 + b)
            view = scenes.view(half, distance, 0.0, np.zeros(3), 0.0)
            fits = []
            for _ in range(VIEWS * draws):
                model = scenes.model_of([view], rng)
                case = Case(
                    scenes.observed(view, rng),
                    view.camera,
                    view.T_camera_object,
                    view.T_camera_object,
                    NO_FEATURES,
                )
                fits.append(fit(case, model, "small_gicp", case.truth))
            row.append(
                f"{sum(f.reason is not None for f in fits)} of {len(fits)} "
                f"({np.median([f.fitness for f in fits]):.2f})"
            )
        rows.append(row)
    text = (
        "True pose seen again from the same view with new noise, started at the truth: refused "
        "(median gate fitness)."
    )
    return f"## Second frame\n\n{text}\n\n" + result.table(
        ["box", *(f"{d:g} m" for d in scenes.RANGES)], rows
    )


def cases(half: tuple[float, float, float], distance: float, seed: int, draws: int) -> list[Case]:
    """Observations at known poses; start poses are START_M and START_RAD off."""
    rng = np.random.default_rng(seed)
    out = []
    for turn in np.linspace(-0.06, 0.06, VIEWS):
        view = scenes.view(half, distance, float(turn), np.zeros(3), 0.0)
        for _ in range(draws):
            features = scenes.features(view, rng)
            start = scenes.disturbed(view.T_camera_object, rng, START_M, START_RAD)
            out.append(
                Case(
                    scenes.observed(view, rng),
                    view.camera,
                    view.T_camera_object,
                    start,
                    features,
                )
            )
    return out


def moved_cases(
    half: tuple[float, float, float], distance: float, kind: str, seed: int, draws: int
) -> list[Case]:
    """The box shifted or turned between two frames; registration starts at the earlier pose."""
    rng = np.random.default_rng(seed)
    shift_m, turn = MOVED[kind]
    before = scenes.view(half, distance, 0.0, np.zeros(3), 0.0)
    out = []
    for k in range(VIEWS):
        angle = k * np.pi / 2 + 0.4
        shift = shift_m * np.array([np.cos(angle), np.sin(angle), 0.0])
        view = scenes.view(half, distance, 0.0, shift, turn)
        for _ in range(draws):
            features = scenes.features(view, rng)
            out.append(
                Case(
                    scenes.observed(view, rng),
                    view.camera,
                    view.T_camera_object,
                    before.T_camera_object,
                    features,
                )
            )
    return out


def quantiles(values: list[float], digits: int) -> str:
    return f"{np.median(values):.{digits}f} / {np.quantile(values, 0.95):.{digits}f}"


def measured(draws: int, progress: Callable[[str], None]) -> list[str]:
    """The tables of accuracy, time and gate."""
    accuracy, gates, times = [], [], {m: [] for m in METHODS}  # type: ignore[var-annotated]
    backend_errors: dict[tuple[str, float], list[tuple[float, float, float]]] = {}
    pooled: dict[tuple[str, float, str], list[tuple[str, Fit]]] = {}
    for b, (box, half) in enumerate(scenes.BOXES.items()):
        for r, distance in enumerate(scenes.RANGES):
            progress(f"{box} at {distance} m")
            seed = 100 * b + 10 * r
            model = scenes.model(half, distance, np.random.default_rng(seed))
            sets = {"true pose": cases(half, distance, seed + 1, draws)}
            sets |= {kind: moved_cases(half, distance, kind, seed + 2, draws) for kind in MOVED}
            row = [box, f"{distance:g}"]
            for backend in BACKENDS:
                backend_errors.setdefault((backend, distance), []).extend(
                    alone(c, model, backend) for c in sets["true pose"]
                )
            for method in METHODS:
                for kind, case_set in sets.items():
                    fits = [
                        fit(c, model, method, c.truth if kind == "true pose" else c.start)
                        for c in case_set
                    ]
                    pooled.setdefault((method, distance, kind), []).extend((box, f) for f in fits)
                    if kind == "true pose":
                        times[method] += [f.seconds * 1e3 for f in fits]
                        row.append(
                            f"{quantiles([f.mm for f in fits], 1)}; "
                            f"{quantiles([f.deg for f in fits], 1)}"
                        )
            accuracy.append(row)
    for method in METHODS:
        for distance in scenes.RANGES:
            true_fits = [f for _, f in pooled[method, distance, "true pose"]]
            rejects = (
                f"{sum(f.reason is not None for f in true_fits)} of {len(true_fits)} "
                f"({np.min([f.fitness for f in true_fits]):.2f})"
            )
            gates.append(
                [
                    method,
                    f"{distance:g}",
                    rejects,
                    *(_moved_cell(pooled[method, distance, kind]) for kind in MOVED),
                ]
            )
    backend_rows = []
    for backend in BACKENDS:
        row = [backend]
        for distance in scenes.RANGES:
            mm, deg, _ = zip(*backend_errors[backend, distance], strict=True)
            row.append(f"{quantiles(list(mm), 1)}; {quantiles(list(deg), 1)}")
        backend_rows.append(
            [
                *row,
                quantiles([ms for d in scenes.RANGES for *_, ms in backend_errors[backend, d]], 1),
            ]
        )
    time_rows = [[m, quantiles(t, 1)] for m, t in times.items()]
    return [
        f"## Accuracy\n\nmm median / p95; deg median / p95; started {START_M * 1e3:g} mm and 2° "
        f"off; {VIEWS * draws} cases per row.\n\n"
        + result.table(["box", "range, m", *METHODS], accuracy),
        "## The backend alone\n\nAs above, all boxes, before the refinement on the measured "
        "normals that `register` adds to each; time of the backend's call.\n\n"
        + result.table(["method", *(f"{d:g} m" for d in scenes.RANGES), "ms"], backend_rows),
        "## Time per call of `register`, one thread\n\nms, median / p95, fitness included.\n\n"
        + result.table(["method", "ms"], time_rows),
        "## Gate\n\nFalse rejects: true poses refused (least gate fitness). Moved boxes, "
        f"registration started where the box was: poses found within {WRONG_MM:g} mm and "
        f"{WRONG_DEG:g}°; then of the wrong ones how many have more than 0.8 of their points "
        "matched within the search radius of 20 mm → pass the gate's own fitness → pass the whole "
        "gate (with the motion limits, 1/30 s).\n\n"
        + result.table(["method", "range, m", "false rejects", *MOVED], gates),
    ]


def _moved_cell(fits: list[tuple[str, Fit]]) -> str:
    """Counts of right poses, and of wrong poses that pass one more condition each.

    Wide fitness over the limit, the gate's fitness over the limit, the whole gate passed.
    """
    limit = RegistrationConfig().c_a_f
    wrong = [(box, f) for box, f in fits if f.mm > WRONG_MM or f.deg > WRONG_DEG]
    passed = [box for box, f in wrong if f.reason is None]
    counts = (
        f"{sum(f.wide_fitness > limit for _, f in wrong)} → "
        f"{sum(f.fitness > limit for _, f in wrong)} → {len(passed)}"
    )
    names = ", ".join(f"{passed.count(b)} {b.split(' ')[0]}" for b in sorted(set(passed)))
    return f"{len(fits) - len(wrong)} right; {counts}" + (f" ({names})" if names else "")


def poses_digest(backend: str, repeats: int) -> str:
    """SHA-256 over the poses of a few cases, each repeated; a text where repeats differ."""
    half = scenes.BOXES["box 16x10x7 cm"]
    model = scenes.model(half, 0.5, np.random.default_rng(0))
    digest = hashlib.sha256()
    config = RegistrationConfig(method=backend)
    for case in cases(half, 0.5, 1, 1):
        poses = {
            register(
                case.observation, model, case.start, None, scenes.FULL, config
            ).T_camera_model.tobytes()
            for _ in range(repeats)
        }
        digest.update(b"".join(sorted(poses)))
        if len(poses) > 1:
            return f"{len(poses)} different results in {repeats} repeats"
    return digest.hexdigest()[:16]


def determinism(repeats: int) -> str:
    rows = []
    for backend in BACKENDS:
        here = poses_digest(backend, repeats)
        command = [
            sys.executable,
            "-m",
            "benchmarks.registration",
            "--digest",
            backend,
            "--repeats",
            str(repeats),
        ]
        others = [
            subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
            for _ in range(2)
        ]
        equal = (
            "yes"
            if len({here, *others}) == 1 and "different" not in here
            else f"no: {here}, {', '.join(others)}"
        )
        rows.append([backend, equal])
    return (
        f"## Determinism\n\n{repeats} repeats in each of 3 processes, bit for bit.\n\n"
        + result.table(["method", "equal"], rows)
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=DRAWS, help="noise draws per view")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument(
        "--digest", choices=sorted(BACKENDS), help="only print the digest of one backend's poses"
    )
    parser.add_argument("--name", default="registration", help="name of the result file")
    args = parser.parse_args()
    limit_threads()
    if args.digest:
        print(poses_digest(args.digest, args.repeats))
        return
    parts = measured(args.draws, lambda text: print(text, file=sys.stderr))
    parts.append(first_model(args.draws))
    parts.append(determinism(args.repeats))
    path = result.write(args.name, "Registration", "python -m benchmarks.registration", parts)
    print(path.read_text(encoding="utf-8"))


set_thread_variables()
if __name__ == "__main__":
    main()
