"""Is a replay that is not the robot's told as such, and at its stage?

`python -m benchmarks.fidelity [MANIFEST] [--trials N]`

The robot is a replay of the same recording: what it believed, chose and commanded is written into
the trial as its own record. Then the trial is replayed with one thing changed, and its stages are
held against that record.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path

from dgeval.config import load_config
from dgeval.determinism import limit_threads
from dgeval.recording.contract import (
    CLOSE_EVENT,
    COMMAND_TOPIC,
    EXECUTE_TOPIC,
    GRASP_TOPIC,
    SCORE_TOPIC,
    TARGET_TOPIC,
    VELOCITY_TOPIC,
)
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import Trial, open_trial
from dgeval.replay.causal import Step, replay
from dgeval.replay.fidelity import Compared, Replayed

from benchmarks.result import table, write

SMOKE = Path("datasets/ci-smoke/ci-smoke.toml")
FRAME_NS = 66_666_667  # of the bundled recordings
OWN = ("grasps.source=ffhnet", "execution.decision=score")
# what is changed, by how much, and the first stage that it belongs to; None: nothing must be told
CHANGES: tuple[tuple[str, str, str | None], ...] = (
    ("nothing", "seed=0", None),
    ("another seed", "seed=1", None),
    ("camera poses one frame late", f"clock.camera_pose.offset_ns={FRAME_NS}", "target"),
    ("perception one frame late", f"schedule.perception_latency_s={FRAME_NS * 1e-9:.4f}", "grasp"),
    ("grasps one frame late", f"schedule.grasps_latency_s={FRAME_NS * 1e-9:.4f}", "grasp"),
    ("servo.c_p_v + 20 %", "servo.c_p_v=1.2", "twist"),
    ("servo.c_p_w + 20 %", "servo.c_p_w=3.0", "twist"),
    ("servo.c_d_v + 20 %", "servo.c_d_v=2.4", "twist"),
    ("estimation.sigma_position + 20 %", "estimation.sigma_position=0.0048", "velocity"),
    ("execution.c_e + 20 %", "execution.c_e=0.48", "decision"),
    ("selection.c_m_t + 20 %", "selection.c_m_t=-0.12", "grasp"),
    ("fusion.epsilon + 20 %", "fusion.epsilon=0.012", "target"),
)


def recorded_by(trial: Trial, steps: list[Step]) -> Trial:
    """The trial as a robot would have recorded it that is this replay."""
    periods = [c for s in steps for c in s.periods]
    own = Replayed()
    for step in steps:
        own.add(step)
    commands = [(c.t_ns, c.command.twist) for c in periods if c.command is not None]
    chosen = [
        (c.t_ns, c.grasps.choice) for c in periods if c.grasps is not None and c.grasps.choice
    ]
    scores = [(t_ns, c.hand_score) for t_ns, c in chosen if c.hand_score is not None]
    decisions = [(c.t_ns, float(c.execute)) for c in periods if c.execute is not None]
    times = {k: v for k, v in trial.scan.times.items() if not k.startswith("/dgeval/belief")}
    scan = replace(
        trial.scan,
        poses={TARGET_TOPIC: own.targets, GRASP_TOPIC: own.grasps},
        twists={VELOCITY_TOPIC: own.velocities, COMMAND_TOPIC: commands},
        numbers={SCORE_TOPIC: scores, EXECUTE_TOPIC: decisions},
        times=times,
    )
    return replace(trial, scan=scan)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("manifest", type=Path, nargs="?", default=SMOKE)
    parser.add_argument("--trials", type=int)
    options = parser.parse_args()
    limit_threads()
    told: dict[str, Counter[str]] = {name: Counter() for name, _, _ in CHANGES}
    at_stage: Counter[str] = Counter()
    any_stage: Counter[str] = Counter()
    specs = find_trials([options.manifest])[: options.trials]
    for spec in specs:
        config = load_config("dynamic", OWN)
        trial = open_trial(spec, config)
        robot = recorded_by(trial, list(replay(trial, config)))
        # a second after the target was last seen nothing is believed of it any more
        last_ns = robot.scan.poses[TARGET_TOPIC][-1].t_ns
        end_ns = min(trial.event_ns(CLOSE_EVENT) or last_ns, last_ns)
        for name, assignment, stage in CHANGES:
            other = load_config("dynamic", (*OWN, assignment))
            beside = replace(open_trial(spec, other), scan=robot.scan)
            compared = Compared(beside, other)
            for step in replay(beside, other):
                compared.add(step)
            found = {f.stage for f in compared.until(end_ns) if f.is_faithful is False}
            told[name].update(found)
            at_stage[name] += stage in found
            any_stage[name] += bool(found)
            print(f"{spec.id}: {name}: {', '.join(sorted(found)) or 'faithful'}", flush=True)
    rows = [
        [
            name,
            stage or "–",
            "–" if stage is None else f"{at_stage[name]}/{len(specs)}",
            f"{any_stage[name]}/{len(specs)}",
            ", ".join(f"{s} {n}" for s, n in sorted(told[name].items())) or "–",
        ]
        for name, _, stage in CHANGES
    ]
    command = "python -m benchmarks.fidelity" + (
        f" --trials {options.trials}" if options.trials else ""
    )
    parts = [
        "The robot is a replay with FFHNet of the same recording; then one thing is changed. A "
        "change that moves nothing by more than the bounds of `replay/fidelity.py` is faithful.",
        table(["changed", "its stage", "told there", "told at any", "stages told"], rows),
    ]
    print(write("fidelity", "Replays that are not the robot's", command, parts).read_text())


if __name__ == "__main__":
    main()
