"""Is a replay that is not the robot's told as such, and at its stage?

`python -m benchmarks.fidelity [MANIFEST] [--trials N]`

The robot is a replay of the same recording: what it believed, chose and commanded is written into
the trial as its own record. Then the trial is replayed with one thing changed, and its stages are
held against that record.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dgeval.config import load_config
from dgeval.determinism import limit_threads
from dgeval.recording.contract import CLOSE_EVENT
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from dgeval.replay.causal import replay
from dgeval.replay.fidelity import Compared, Fidelity, spread_of
from dgeval.replay.replayed import Replayed

from benchmarks.result import table, write

SMOKE = Path("datasets/ci-smoke/ci-smoke.toml")
FRAME_NS = 66_666_667  # of the bundled recordings
MOVED = 1e-9  # m, m/s, rad, s or a share; less is no other result
OWN = ("grasps.source=ffhnet", "execution.decision=score")
# what is changed, by how much, and the first stage that it belongs to; None: nothing must be told
CHANGES: tuple[tuple[str, str, str | None], ...] = (
    ("nothing", "seed=0", None),
    ("another seed", "seed=7", None),
    ("the arm's joints one frame late", f"clock.hand_joints.offset_ns={FRAME_NS}", "velocity"),
    ("perception one frame late", f"schedule.perception_latency_s={FRAME_NS * 1e-9:.4f}", "grasp"),
    ("grasps one frame late", f"schedule.grasps_latency_s={FRAME_NS * 1e-9:.4f}", "grasp"),
    ("servo.c_p_v + 20 %", "servo.c_p_v=1.2", "twist"),
    ("servo.c_p_w + 20 %", "servo.c_p_w=3.0", "twist"),
    ("servo.c_d_v + 20 %", "servo.c_d_v=2.4", "twist"),
    ("servo.c_O + 20 %", "servo.c_O=0.24", "twist"),
    ("estimation.sigma_position + 20 %", "estimation.sigma_position=0.0048", "velocity"),
    ("estimation.sigma_acceleration + 20 %", "estimation.sigma_acceleration=0.6", "velocity"),
    ("execution.c_e + 20 %", "execution.c_e=0.48", "decision"),
    ("selection.c_m_t + 20 %", "selection.c_m_t=-0.12", "grasp"),
    ("fusion.epsilon + 20 %", "fusion.epsilon=0.012", "target"),
)


def differing(stages: Sequence[Fidelity]) -> set[str]:
    """Stages told as not the robot's."""
    return {one.stage for one in stages if one.is_other}


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
    moved: Counter[str] = Counter()
    specs = find_trials([options.manifest])[: options.trials]
    for spec in specs:
        config = load_config("dynamic", (*OWN, "fidelity.seeds=2"))
        trial = open_trial(spec, config)
        own = Replayed()
        for step in replay(trial, config):
            own.add(step)
        robot = own.as_robot(trial)
        # a second after the target was last seen nothing is believed of it any more
        last_ns = own.targets[-1].t_ns
        end_ns = min(trial.event_ns(CLOSE_EVENT) or last_ns, last_ns)
        spread = spread_of(trial, config, own, end_ns)
        for name, assignment, stage in CHANGES:
            other = load_config("dynamic", (*OWN, assignment))
            beside = replace(open_trial(spec, other), scan=robot.scan)
            compared = Compared(beside, other)
            for step in replay(beside, other):
                compared.add(step)
            stages = compared.until(end_ns, spread)
            found = differing(stages)
            told[name].update(found)
            at_stage[name] += stage in found
            moved[name] += any(
                max((*one.errors, *one.alone), default=0.0) > MOVED
                for one in stages
                if one.stage == stage
            )
            any_stage[name] += bool(found)
            print(f"{spec.id}: {name}: {'; '.join(one.told for one in stages)}", flush=True)
    rows = [
        [
            name,
            stage or "–",
            "–" if stage is None else f"{moved[name]}/{len(specs)}",
            "–" if stage is None else f"{at_stage[name]}/{moved[name]}",
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
        "stage is told where it makes something else of the robot's own inputs; where these aren't "
        "recorded, where its result is beyond the bounds of `replay/fidelity.py` and beyond what "
        "two other seeds show.",
        table(["changed", "its stage", "moved", "told there", "told at any", "stages told"], rows),
        "`moved`: trials in which the change gave its stage another result at all; told there: of "
        "these.",
    ]
    print(write("fidelity", "Replays that are not the robot's", command, parts).read_text())


if __name__ == "__main__":
    main()
