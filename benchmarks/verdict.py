"""Verdicts against the truth, over simulated failures that set nothing:
`python -m benchmarks.verdict [OPTIONS]`.

Physics first: trials are simulated without images, and what the second pass would have seen is
modelled (`benchmarks.modelled`). Robustness is measured by changing the simulated world in ways the
verdict does not know.
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import dgeval.worlds  # noqa: F401  # isort: skip  (it chooses how images are drawn before mujoco is imported)
import numpy as np
from dgeval.config import VerdictConfig
from dgeval.determinism import limit_threads
from dgeval.failure_rule import CLASSES, HANDED_OVER, Thresholds, Unknown
from dgeval.hindsight.second_pass import blind_gap
from dgeval.simulation.blame import blame
from dgeval.simulation.campaign import Campaign, grasps_of, plan_of, simulate, world_of
from dgeval.simulation.perception import ModelledPerception
from dgeval.simulation.physics import Physics
from dgeval.simulation.scenario import Plan, load_scenario
from dgeval.simulation.trial import Run, run_trial
from dgeval.simulation.truth import Prover, prove
from dgeval.simulation.world import World
from dgeval.statistics import calibration_error, confusion, macro_f1, wilson
from dgeval.verdict.decide import Decision, blame_of, undecided
from dgeval.verdict.draws import decide_scene
from dgeval.verdict.outcome import outcome_of
from dgeval.worlds.closing import CONTROL_S

from benchmarks.modelled import at_ns, log_of_run, scene_of_run
from benchmarks.result import RESULTS, table, write
from benchmarks.simulation import PUBLISHED, rates

# m, thresholds of the baseline on the causal pass; ours, not fitted to anything
AWAY_M, JUMP_M = 0.015, 0.010
# control periods of a trial that began; a jaw gripper without a seed in reach stops at once
MIN_TICKS = 20
# the part of the robot that each injected fault is an error of
PART_OF = {
    "hand_eye": "tracking",
    "registration_bias": "tracking",
    "tracker_drift": "tracking",
    "velocity_bias": "velocity",
    "latency": "velocity",
    "grasp_offset": "synthesis",
    "descent": "servo",
    "evaluator_bias": "execution",
    "close_shift": "execution",
}
# Changes of the simulated world that the verdict does not know of, and a factor of the truth's
# thresholds; ours.
VARIANTS = {
    "as simulated": (Physics(), 1.0),
    "friction x 0.7": (Physics(friction=0.7), 1.0),
    "friction x 1.4": (Physics(friction=1.4), 1.0),
    "mass x 0.7": (Physics(mass=0.7), 1.0),
    "mass x 1.3": (Physics(mass=1.3), 1.0),
    "contacts twice as soft": (Physics(softness=2.0), 1.0),
    "links 1.5 mm thicker": (Physics(radius=0.0015), 1.0),
    "links 1.5 mm thinner": (Physics(radius=-0.0015), 1.0),
    "pyramidal friction cone, 20 iterations": (Physics(other_solver=True), 1.0),
    "label thresholds x 0.8": (Physics(), 0.8),
    "label thresholds x 1.2": (Physics(), 1.2),
}


def causal_guess(run: Run, world: World) -> str:
    """A class from thresholds on the beliefs of the causal pass alone.

    It asks whether the hand never closed, whether the object jumped, and whether the hand was away.
    """
    if run.close is None:
        return "timing"
    observed = [
        f for f in run.frames if f.accepted and f.tick <= run.close and f.T_base_object is not None
    ]
    for a, b in pairwise(observed):
        assert a.T_base_object is not None
        assert b.T_base_object is not None
        moved = b.T_base_object[:3, 3] - a.T_base_object[:3, 3]
        if (
            a.velocity is not None
            and np.linalg.norm(moved - a.velocity * (b.tick - a.tick) * CONTROL_S) > JUMP_M
        ):
            return "collision"
    world.restore(run.ticks[run.close].snapshot)
    grasp = run.ticks[run.close].T_base_grasp
    away = np.inf if grasp is None else np.linalg.norm(world.T_base_palm()[:3, 3] - grasp[:3, 3])
    return "timing" if away > AWAY_M else "imprecise_pose"


@dataclass(frozen=True)
class Job:
    """One trial to judge.

    unrefined: the jaw gripper takes the seed as it is, which fails more often. pushed: judge only
    failures in which the object was off its path before the close; collisions are among them.
    """

    scenario: str
    seed: int
    index: int
    variant: str
    draws: int
    methods: tuple[str, ...]
    blame: bool
    unrefined: bool
    pushed: bool


def judge(job: Job) -> dict[str, Any]:
    """One trial: the truth, and each method's verdict if it failed."""
    limit_threads()
    scenario = load_scenario(job.scenario).model_copy(update={"choose": None})
    if job.unrefined:
        vfas = scenario.pipeline.vfas.model_copy(update={"refine": False})
        scenario = scenario.model_copy(
            update={"pipeline": scenario.pipeline.model_copy(update={"vfas": vfas})}
        )
    campaign = Campaign(scenario, job.seed, 1, Path("unused"))
    plan = plan_of(campaign, job.index)
    physics, scale = VARIANTS[job.variant]
    if scenario.vfas:
        run, world = simulate(campaign, plan)
    else:
        world = world_of(campaign, plan)
        physics.put(world)
        perceiver = ModelledPerception(scenario, plan, world)
        run = run_trial(plan, scenario, world, grasps_of(campaign, plan), perceiver)
    succeeded = run.finish is not None and run.finish.success
    log = log_of_run(run, world, scenario.pipeline)
    sighted = [at_ns(f.tick) for f in run.frames if f.accepted]
    gap, sided = blind_gap(sighted, log.close_ns)
    out: dict[str, Any] = {
        "scenario": job.scenario,
        "id": plan.id,
        "seed": job.seed,
        "index": job.index,
        "variant": job.variant,
        "object": plan.object,
        "speed": plan.nominal_speed,
        "closed": run.close is not None,
        "outcome": "success" if succeeded else "failure",
        "outcome_said": outcome_of(log, None).outcome,
        "gap_s": gap,
        "gap_sided": sided,
        "present": plan.faults.present(),
    }
    if succeeded or len(run.ticks) < MIN_TICKS:
        return out
    th = HANDED_OVER if world.presenter is not None else Thresholds()
    if job.pushed:
        metres, degrees = Prover(run, world).displacement()
        if metres.max() <= th.moved_m and degrees.max() <= th.moved_deg:
            return out
    truth = prove(
        run,
        world,
        Thresholds(
            th.moved_m * scale, th.moved_deg * scale, th.overlap_m * scale, 2, th.unstable_m * scale
        ),
    )
    out["outcome"] = truth.outcome
    if truth.outcome != "failure":  # the hand never came near
        return out
    out.update(
        truth=truth.failure_class,
        seen=truth.observed_class,
        sub=truth.sub_cause,
        shift_s=truth.shift_s,
        near=list(truth.near),
        curve=truth.curve,
        faults=asdict(plan.faults),
        causal=causal_guess(run, world),
        pose_error_m=truth.pose_error_m,
    )
    if job.blame:
        out["blame"] = blame(plan, lambda p: _succeeds(campaign, p))
    scene = scene_of_run(run, world, scenario.pipeline, job.seed)
    for method in job.methods:
        start = time.process_time()
        decision: Decision | Unknown
        if isinstance(scene, Unknown):
            decision = scene
        else:
            decision = decide_scene(scene, method, job.draws, 0, VerdictConfig().least)
        if isinstance(decision, Unknown):
            decision = undecided(decision.reason, method)
        answer, draws = decision.answer, decision.draws
        known = None if isinstance(answer, Unknown) else answer
        blamed = blame_of(decision, scene if isinstance(scene, Unknown) else scene.beliefs)
        unblamed = blamed.part if isinstance(blamed.part, Unknown) else None
        out[method] = {
            "class": known.failure_class if known else "unknown",
            "seen": "unknown"
            if isinstance(decision.observed_class, Unknown)
            else decision.observed_class,
            "p_seen": decision.observed,
            "p": decision.probabilities,
            "sub": known.sub_cause if known else None,
            "shift_s": known.shift_s if known else None,
            "reproduced": draws.share_reproduced,
            "seconds": time.process_time() - start,
            "draws": [(d.verdict.failure_class, d.reproduced, d.weight) for d in draws.asked],
            "why": answer.reason if isinstance(answer, Unknown) else None,
            "blame": "unknown" if unblamed else blamed.part,
            "blame_why": unblamed.reason if unblamed else None,
            "errors": blamed.sizes,
        }
    return out


def _succeeds(campaign: Campaign, plan: Plan) -> bool:
    finish = simulate(campaign, plan)[0].finish
    return finish is not None and finish.success


def blame_table(rows: list[dict[str, Any]], method: str) -> str:
    """The blamed part beside the one fault whose removal restores success.

    Only failures that have such a fault count.
    """
    known = [r for r in rows if r.get("blame") and r["blame"]["fault"] in PART_OF]
    terms = [*dict.fromkeys(PART_OF.values()), "unknown"]
    faults = [f for f in PART_OF if any(r["blame"]["fault"] == f for r in known)]
    lines = [
        "| fault \\ blamed | " + " | ".join(terms) + " | right |",
        "|---|" + "---|" * (len(terms) + 1),
    ]
    for fault in faults:
        predicted = [r[method]["blame"] for r in known if r["blame"]["fault"] == fault]
        right = predicted.count(PART_OF[fault])
        lines.append(
            f"| {fault} | "
            + " | ".join(str(predicted.count(t)) for t in terms)
            + f" | {right}/{len(predicted)} |"
        )
    named = [r for r in known if r[method]["blame"] != "unknown"]
    right = sum(r[method]["blame"] == PART_OF[r["blame"]["fault"]] for r in named)
    share = wilson(right, len(named))
    about = (
        f"{len(known)} failures with one such fault; "
        f"a part is named in {len(named)}, rightly in {right}"
    )
    return "\n".join(
        [
            *lines,
            "",
            f"{about} ({right / max(len(named), 1):.0%}) [{share[0]:.0%}, {share[1]:.0%}].",
        ]
    )


def crossed(truth: list[str], said: list[str]) -> list[str]:
    """Lines of a confusion matrix."""
    matrix = confusion(truth, said, [*CLASSES, "unknown"])[: len(CLASSES)]
    return [
        "| truth \\ said | " + " | ".join([*CLASSES, "unknown"]) + " |",
        "|---|---|---|---|---|",
        *(
            f"| {c} | " + " | ".join(str(v) for v in row) + " |"
            for c, row in zip(CLASSES, matrix.tolist(), strict=True)
        ),
    ]


def scores(rows: list[dict[str, Any]], predicted: list[str]) -> str:
    """Right, abstained and macro-F1 of a row of a table; an abstention counts as wrong."""
    truth = [r["truth"] for r in rows]
    f1, low, high = macro_f1(truth, predicted, CLASSES)
    right = sum(a == b for a, b in zip(truth, predicted, strict=True))
    return (
        f"{len(rows)} | {right / len(rows):.0%} | {predicted.count('unknown')} | "
        f"{f1:.2f} [{low:.2f}, {high:.2f}]"
    )


def tables(rows: list[dict[str, Any]], methods: tuple[str, ...]) -> str:
    """Markdown of one variant.

    It holds outcome, classes with baselines and parts, confusion, calibration and sub-cause.
    """
    # without a close the outcome hangs on hindsight, which is not in these rows
    closed = [r for r in rows if r["closed"]]
    ended = sum(r["outcome_said"] == r["outcome"] for r in closed)
    low, high = wilson(ended, len(closed))
    lines = [
        f"Outcome without labels: {ended} of {len(closed)} right ({ended / len(closed):.1%}) "
        f"[{low:.1%}, {high:.1%}]"
    ]
    failed = [r for r in rows if "truth" in r]
    head = ["| instrument | failures | right | unknown | macro-F1 |", "|---|---|---|---|---|"]
    lines += ["", *head]
    for method in methods:
        parts = {
            "": failed,
            ", clear": [r for r in failed if not r["near"]],
            ", near a threshold": [r for r in failed if r["near"]],
        }
        wrong_camera = [r for r in failed if "hand_eye" in r["present"]]
        if wrong_camera:
            parts |= {
                ", hand-eye as calibrated": [r for r in failed if r not in wrong_camera],
                ", hand-eye off": wrong_camera,
            }
        parts |= {
            f", gap {s}": [r for r in failed if r["gap_sided"] == s] for s in ("none", "one", "two")
        }
        for name, part in parts.items():
            if part:
                lines.append(
                    f"| {method}{name} | {scores(part, [r[method]['class'] for r in part])} |"
                )
    majority = max(CLASSES, key=[r["truth"] for r in failed].count)
    lines.append(f"| always {majority} | {scores(failed, [majority] * len(failed))} |")
    lines.append(
        f"| thresholds on the causal pass | {scores(failed, [r['causal'] for r in failed])} |"
    )
    for method in methods:
        lines += ["", f"{method}, by what would have had to be different:", ""]
        lines += crossed([r["truth"] for r in failed], [r[method]["class"] for r in failed])
        labelled = [r for r in failed if "seen" in r]
        if labelled:
            saw = [r["seen"] for r in labelled]
            said = [r[method]["seen"] for r in labelled]
            f1, least, most = macro_f1(saw, said, CLASSES)
            lines += ["", f"{method}, as a person at the video would write:", ""]
            lines += crossed(saw, said)
            lines += ["", f"Macro-F1 {f1:.2f} [{least:.2f}, {most:.2f}]."]
        answered = [r for r in failed if r[method]["class"] != "unknown"]
        hits = [r for r in answered if r[method]["class"] == r["truth"]]
        p = np.array([max(r[method]["p"][:3]) for r in answered])
        error = calibration_error(p, np.array([r in hits for r in answered]))
        same = sum(r[method]["sub"] == r["sub"] for r in hits)
        seconds = np.quantile([r[method]["seconds"] for r in failed], [0.5, 0.95])
        about = [
            f"Answered: {len(answered)}, right {len(hits) / max(len(answered), 1):.0%}, "
            f"stated {p.mean():.0%}, ECE {error:.3f}"
        ]
        about += [f"of the right ones the sub-cause is right in {same} of {len(hits)}"]
        if timed := [
            abs(r[method]["shift_s"] - r["shift_s"]) for r in hits if r["truth"] == "timing"
        ]:
            about += [
                f"the close time is off by a median of {np.median(timed):.2f} s "
                f"(90 %: {np.quantile(timed, 0.9):.2f} s)"
            ]
        if any(r.get("blame") for r in failed):
            lines += ["", blame_table(failed, method)]
        lines += [
            "",
            "; ".join([*about, f"CPU time {seconds[0]:.1f} s (95 %: {seconds[1]:.1f} s)."]),
        ]
    return "\n".join(lines)


def beside_the_paper(rows: list[dict[str, Any]], method: str, paper: dict[str, Any]) -> str:
    """Success by speed and object, and the failures' shares by truth and by verdict.

    For a scenario that a paper has too. Beside the paper stand the shares that count as it does.
    """
    ended = [
        {
            "verdict": {
                "failure_class": r.get("truth")
                or (None if r["outcome"] == "success" else "not begun"),
                **r,
            }
        }
        for r in rows
    ]
    failed = [r for r in rows if "truth" in r]
    columns = [[r.get("seen") for r in failed], [r[method].get("seen") for r in failed],
               [r["truth"] for r in failed], [r[method]["class"] for r in failed]]  # fmt: skip
    lines = []
    for c in (*CLASSES, "unknown"):
        cells = []
        for predicted in columns:
            k = predicted.count(c)
            low, high = wilson(k, len(predicted))
            cells.append(
                f"{k}/{len(predicted)} = {k / max(len(predicted), 1):.0%} [{low:.0%}, {high:.0%}]"
            )
        share = paper["printed"]["failures"].get(c)
        lines.append([c, "–" if share is None else f"{share} %", *cells])
    never = sum(not r["closed"] for r in rows)
    return "\n\n".join([
        *([rates(ended, paper, "speed")] if len({r["speed"] for r in rows}) > 1 else []),
        rates(ended, paper, "object"),
        f"{never} of {len(rows)} hands never closed.",
        table(
            [
                "failures",
                "paper",
                "as seen, by truth",
                f"as seen, by the {method}",
                "what would have had to differ, by truth",
                f"likewise, by the {method}",
            ],
            lines,
        ),
    ])  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenario", default="failures")
    parser.add_argument(
        "--seed",
        type=int,
        default=3000,
        help="no other part of the project uses the default's trials",
    )
    parser.add_argument(
        "--trials",
        type=int,
        default=320,
        help="simulated trials; the failures among them are judged",
    )
    parser.add_argument(
        "--first",
        type=int,
        default=0,
        help="index of the first; rows are added to those of an earlier run",
    )
    parser.add_argument("--draws", type=int, default=VerdictConfig().draws)
    parser.add_argument("--variant", action="append", choices=list(VARIANTS))
    parser.add_argument("--method", action="append", choices=["twin", "geometry"])
    parser.add_argument(
        "--blame",
        type=int,
        default=0,
        help="of so many first trials also find and score the fault to blame",
    )
    parser.add_argument(
        "--unrefined",
        action="store_true",
        help="VFAS-Grasp's scenarios with the seed executed as it is",
    )
    parser.add_argument(
        "--pushed",
        action="store_true",
        help="only failures in which the object was pushed before the close",
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--tables", action="store_true", help="only print the tables of an earlier run's rows again"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=RESULTS / "verdict.md",
        help="with a .jsonl of all rows beside it",
    )
    options = parser.parse_args()
    methods = tuple(options.method or ["twin", "geometry"])
    kept = options.out.with_suffix(".jsonl")
    rows: list[dict[str, Any]] = (
        [json.loads(line) for line in kept.read_text().splitlines()] if options.tables else []
    )
    methods = tuple(m for m in methods if not rows or any(m in r for r in rows))
    if not options.tables:
        jobs = [
            Job(
                options.scenario,
                options.seed,
                k,
                variant,
                options.draws,
                methods,
                k < options.blame,
                options.unrefined,
                options.pushed,
            )
            for variant in options.variant or ["as simulated"]
            for k in range(options.first, options.trials)
        ]
        if options.first:
            rows += [json.loads(line) for line in kept.read_text().splitlines()]
        with (
            ProcessPoolExecutor(options.jobs) as pool,
            kept.open("a" if options.first else "w") as file,
        ):
            for row in pool.map(judge, jobs):
                rows.append(row)
                file.write(json.dumps(row) + "\n")
                file.flush()
    ran = [v for v in VARIANTS if any(r["variant"] == v for r in rows)]
    parts = [f"## {v}\n\n{tables([r for r in rows if r['variant'] == v], methods)}" for v in ran]
    scenario = rows[0].get("scenario", "failures")
    if scenario in PUBLISHED and "printed" in PUBLISHED[scenario]:
        parts.append(
            "## Beside the paper\n\n" + beside_the_paper(rows, methods[0], PUBLISHED[scenario])
        )
    command = f"python -m benchmarks.verdict --scenario {scenario} --seed {rows[0]['seed']}"
    command += f" --trials {len(rows) // len(ran)} --draws {options.draws}"
    command += (f" --blame {options.blame}" if options.blame else "") + (
        " --unrefined" if options.unrefined else ""
    )
    command += " --pushed" if options.pushed else ""
    title = "Verdicts on simulated failures that set nothing"
    print(
        write(options.out.stem, title, command, parts, options.out.parent).read_text(
            encoding="utf-8"
        )
    )


if __name__ == "__main__":
    main()
