"""Hands that dgeval doesn't know, against the truth: `python -m benchmarks.other_hands`.

Failures are simulated with a hand of `benchmarks/hands`, physics first (see `benchmarks.verdict`):
the hand of the truth is MuJoCo's import of the URDF, that of the verdict what the recorded
description gives, with meshes and with capsules in their place. The same seeds with the five-finger
hand by name stand beside. `--wrong` puts an error into the description alone. `--per-class` works
out the truth of trial after trial, of each scenario in turn, until there are so many failures of
each class, and judges those. What an earlier run of the same command and the same sources has
worked out is kept: each row is written as it is made (`.jsonl` beside the results).
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import dgeval.worlds  # noqa: F401  # isort: skip  (it chooses how images are drawn before mujoco is imported)
import numpy as np
from dgeval.config import VerdictConfig
from dgeval.determinism import limit_threads
from dgeval.errors import UsageError
from dgeval.failure_rule import CLASSES, Thresholds, Unknown
from dgeval.simulation.campaign import Campaign, find_grasps, grasps_of, plan_of, world_of
from dgeval.simulation.imported_hand import ImportedHand
from dgeval.simulation.perception import ModelledPerception
from dgeval.simulation.scenario import load_scenario, with_hand
from dgeval.simulation.trial import run_trial
from dgeval.simulation.truth import prove
from dgeval.statistics import calibration_error, confusion, macro_f1, wilson
from dgeval.verdict.decide import undecided
from dgeval.verdict.draws import decide_scene
from dgeval.verdict.evidence import scene_of
from dgeval.verdict.outcome import outcome_of
from dgeval.worlds.hand_and_object import UnstableError
from dgeval.worlds.objects import ten_objects

from benchmarks.modelled import hindsight_of_run, log_of_run
from benchmarks.result import RESULTS, source_digest, table, write
from benchmarks.verdict import MIN_TICKS

HERE = Path(__file__).parent / "hands"
BY_NAME = "five-finger hand, by name"


def _mimic_turned(text: str) -> str:
    return re.sub(
        r'(<mimic [^>]*multiplier=")([^"]*)', lambda m: m[1] + str(-float(m[2])), text, count=1
    )


def _axis_reversed(text: str) -> str:
    """The first moving joint of the last finger turns, or slides, the other way."""
    joints = [(m.start(), _joint(text, m.start())) for m in re.finditer(r"<axis ", text)]
    at = [k for k, joint in joints if "arm_" not in joint and 'type="fixed"' not in joint]
    head, tail = text[: at[-1]], text[at[-1] :]
    numbers = re.search(r'xyz="([^"]*)"', tail)
    assert numbers is not None
    other = " ".join(str(-float(v)) for v in numbers[1].split())
    return head + tail.replace(numbers[1], other, 1)


def _joint(text: str, at: int) -> str:
    return text[text.rindex("<joint", 0, at) : at]


def _larger(text: str) -> str:
    """Meshes and boxes of the hand larger by a fifth."""
    text = re.sub(r"(<mesh [^>]*?)(/?>)", r'\1 scale="1.2 1.2 1.2"\2', text)
    return re.sub(
        r'(<box size=")([^"]*)',
        lambda m: m[1] + " ".join(str(1.2 * float(v)) for v in m[2].split()),
        text,
    )


WRONG: dict[str, Callable[[str], str]] = {
    "right": str,
    "mimic turned": _mimic_turned,
    "meshes x 1.2": _larger,
    "axis reversed": _axis_reversed,
}


@dataclass(frozen=True)
class Job:
    """One trial. hand: a file's stem, or BY_NAME. ways: of the description's solids. until: what is
    worked out last: the outcome, the truth of a failure, or the verdict on it.
    """

    hand: str
    scenario: str
    seed: int
    index: int
    ways: tuple[str, ...]
    wrong: str
    work: Path
    until: Literal["outcome", "truth", "verdict"]


def campaign_of(job: Job) -> Campaign:
    scenario = load_scenario(job.scenario).model_copy(update={"choose": None})
    if job.hand != BY_NAME:
        scenario = with_hand(scenario, HERE / f"{job.hand}.toml")
    return Campaign(scenario, job.seed, 1, job.work / job.hand)


def prepare(job: Job) -> None:
    """Find the hand's grasps of the object number `index`."""
    find_grasps(campaign_of(job), job.index)


def judge(job: Job) -> dict[str, Any]:
    """One trial: the truth, and what each way of knowing the hand says."""
    limit_threads()
    try:
        return _judged(job)
    except UnstableError:
        out = {"hand": job.hand, "scenario": Path(job.scenario).stem, "index": job.index}
        return {**out, "unstable": True, "closed": False}


def _judged(job: Job) -> dict[str, Any]:
    campaign = campaign_of(job)
    scenario = campaign.scenario
    plan = plan_of(campaign, job.index)
    world = world_of(campaign, plan)
    perceiver = ModelledPerception(scenario, plan, world)
    run = run_trial(plan, scenario, world, grasps_of(campaign, plan), perceiver)
    held = run.finish is not None and run.finish.success
    hand = scenario.gripper
    out: dict[str, Any] = {"hand": job.hand, "scenario": scenario.name, "index": job.index}
    out["wrong"] = job.wrong
    out |= {"object": plan.object, "closed": run.close is not None, "held": held}
    for way in job.ways:
        dirs = hand.mesh_dirs if isinstance(hand, ImportedHand) and way == "meshes" else ()
        calibration = scenario.pipeline.calibration.model_copy(update={"mesh_dirs": dirs})
        config = scenario.pipeline.model_copy(update={"calibration": calibration})
        try:
            log = log_of_run(run, world, config, WRONG[job.wrong])
        except UsageError as error:
            out[way] = {"outcome": "unknown", "class": "unknown", "why": str(error), "p": []}
            continue
        out[way] = {"outcome": outcome_of(log, None).outcome, "log": log}
    truth = None
    if job.until != "outcome" and not held and len(run.ticks) >= MIN_TICKS:
        proved = prove(run, world, Thresholds())
        truth = proved.failure_class if proved.outcome == "failure" else None
    if truth is not None:
        out["truth"] = truth
    for way in job.ways:
        log = out[way].pop("log", None)
        if truth is None or log is None or job.until != "verdict":
            continue
        start = time.process_time()
        hindsight = hindsight_of_run(run, world, log, job.seed)
        scene = Unknown("never tracked") if hindsight is None else scene_of(log, hindsight)
        decision: Any = scene
        if not isinstance(scene, Unknown):
            decision = decide_scene(scene, "twin", VerdictConfig().draws, 0, VerdictConfig().least)
        if isinstance(decision, Unknown):
            decision = undecided(decision.reason, "twin")
        answer = decision.answer
        unknown = isinstance(answer, Unknown)
        out[way] |= {
            "class": "unknown" if unknown else answer.failure_class,
            "why": answer.reason if unknown else None,
            "p": decision.probabilities,
            "seconds": time.process_time() - start,
        }
    return out


def tables(rows: list[dict[str, Any]], ways: tuple[str, ...]) -> str:
    """Markdown of one hand."""
    unstable = sum("unstable" in r for r in rows)
    closed = [r for r in rows if r["closed"]]
    failed = [r for r in rows if "truth" in r and "class" in r[ways[0]]]
    if not failed:
        return "\n".join(
            f"{way}: {sum((r[way]['outcome'] == 'success') == r['held'] for r in closed)} of "
            f"{len(closed)} outcomes right"
            for way in ways
        )
    truth = [r["truth"] for r in failed]
    lines, parts = [], []
    for way in ways:
        ended = sum((r[way]["outcome"] == "success") == r["held"] for r in closed)
        unsaid = sum(r[way]["outcome"] == "unknown" for r in closed)
        low, high = wilson(ended, len(closed))
        said = [r[way]["class"] for r in failed]
        f1, f_low, f_high = macro_f1(truth, said, CLASSES)
        answered = [r for r in failed if r[way]["class"] != "unknown"]
        off = calibration_error(
            np.array([max(r[way]["p"][:3]) for r in answered]),
            np.array([r["truth"] == r[way]["class"] for r in answered]),
        )
        lines.append([
            way, f"{ended} of {len(closed)} [{low:.2f}, {high:.2f}], {unsaid} unknown",
            str(len(failed)), str(said.count("unknown")), f"{f1:.2f} [{f_low:.2f}, {f_high:.2f}]",
            f"{off:.2f}", f"{np.mean([r[way].get('seconds', 0.0) for r in failed]):.1f}",
        ])  # fmt: skip
        classes = [*CLASSES, "unknown"]
        matrix = confusion(truth, said, classes)[:3]
        counted = [[c, *map(str, row)] for c, row in zip(CLASSES, matrix, strict=True)]
        parts.append(f"{way}, truth in rows:\n\n{table(['', *classes], counted)}")
    head = ["solids", "outcome right", "failures", "unknown", "macro-F1", "calibration", "CPU s"]
    left = [f"Left out: {unstable} trials whose physics was unstable."] if unstable else []
    return "\n\n".join([table(head, lines), *left, *parts])


class Kept:
    """Rows of jobs, written as they are made, and read where a run was broken off."""

    def __init__(self, path: Path, pool: ProcessPoolExecutor) -> None:
        self.path, self.pool, self.sources = path, pool, source_digest()
        lines = path.read_text("utf-8").splitlines() if path.exists() else []
        self.rows = {row["job"]: row for row in map(json.loads, lines)}

    def judged(self, jobs: list[Job]) -> Iterator[dict[str, Any]]:
        """A row for each job, in order."""
        names = [
            f"{self.sources} {j.hand} {Path(j.scenario).stem} {j.seed} {j.index} {j.ways} "
            f"{j.wrong} {j.until}"
            for j in jobs
        ]
        new = [(n, j) for n, j in zip(names, jobs, strict=True) if n not in self.rows]
        made = zip(new, self.pool.map(judge, [j for _, j in new]), strict=True)
        for name in names:
            if name not in self.rows:
                (of, _), row = next(made)
                self.rows[of] = {"job": of, **row}
                with self.path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(self.rows[of]) + "\n")
            yield self.rows[name]


def draw_until(
    kept: Kept, jobs: list[Job], count: int, at_once: int
) -> tuple[list[dict[str, Any]], list[Job]]:
    """The truth of trials in order until each class has `count` failures, and those to judge."""
    rows: list[dict[str, Any]] = []
    chosen: list[Job] = []
    have = dict.fromkeys(CLASSES, 0)
    for k in range(0, len(jobs), at_once):
        part = jobs[k : k + at_once]
        for job, row in zip(part, kept.judged(part), strict=True):
            rows.append(row)
            truth = row.get("truth")
            if truth is not None and have[truth] < count:
                have[truth] += 1
                chosen.append(replace(job, until="verdict"))
        if min(have.values()) >= count:
            break
    print(f"{len(rows)} trials: {have}", flush=True)
    return rows, chosen


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = sorted(p.stem for p in HERE.glob("*.toml"))
    parser.add_argument("--hand", action="append", help=f"default: {', '.join(names)}, known")
    parser.add_argument("--scenario", action="append", help="default: failures")
    parser.add_argument("--seed", type=int, default=7300)
    parser.add_argument("--trials", type=int, default=60, help="of each scenario, at most")
    parser.add_argument("--per-class", type=int, help="failures of each class to judge")
    parser.add_argument("--way", action="append", help="meshes, capsules; default: both")
    parser.add_argument("--wrong", default="right", choices=WRONG)
    parser.add_argument("--outcome-only", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--work", type=Path, default=Path("runs/other_hands"))
    parser.add_argument("--out", type=Path, default=RESULTS / "other_hands.md")
    options = parser.parse_args()
    parts = []
    with ProcessPoolExecutor(options.jobs) as pool:
        kept = Kept(options.out.with_suffix(".jsonl"), pool)
        for hand in options.hand or [*names, "known"]:
            known = hand == "known"
            name = BY_NAME if known else hand
            ways = ("by name",) if known else tuple(options.way or ("meshes", "capsules"))

            def job(
                scenario: str,
                index: int,
                until: Any = "outcome" if options.outcome_only else "verdict",
                name: str = name,
                ways: tuple[str, ...] = ways,
            ) -> Job:
                common = (scenario, options.seed, index, ways, options.wrong)
                return Job(name, *common, options.work, until)

            scenarios = options.scenario or ["failures"]
            if not known:
                list(pool.map(prepare, [job(scenarios[0], k) for k in range(len(ten_objects()))]))
            wanted = [job(s, k) for k in range(options.trials) for s in scenarios]
            rows = []
            if options.per_class:
                first = [replace(j, until="truth") for j in wanted]
                rows, wanted = draw_until(kept, first, options.per_class, 4 * options.jobs)
            known_rows = {(r["scenario"], r["index"]): r for r in rows}
            for row in kept.judged(wanted):
                known_rows[row["scenario"], row["index"]] = row
            rows = list(known_rows.values())
            parts.append(f"## {name}\n\n{tables(rows, ways)}")
    command = f"python -m benchmarks.other_hands --seed {options.seed} --trials {options.trials}"
    command += f" --wrong '{options.wrong}'" if options.wrong != "right" else ""
    title = "Hands that dgeval does not know"
    print(write(options.out.stem, title, command, parts, options.out.parent).read_text("utf-8"))


if __name__ == "__main__":
    main()
