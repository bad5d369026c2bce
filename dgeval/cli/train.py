"""dgeval train: the networks that ship with dgeval, made again."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dgeval.cli.boundary import command, print_json

if TYPE_CHECKING:
    from rich.progress import TaskID

Progressed = Callable[[str, int, dict[str, float]], None]
EXAMPLES = """\b
Examples:
  dgeval train ffhnet --out runs/ffhnet --jobs 2        (more than an hour on two cores)
  dgeval train ffhnet --out runs/quick --objects 18 --tried 60 --views 20 --steps 200
  dgeval train vfas --out runs/vfas --jobs 2            (its steps took 10 and 26 minutes)
  dgeval train ffhnet-evaluator --out runs/tuned        (some 40 minutes on one core)

Stopped runs go on where they were. Use what comes out with
  dgeval replay … --set grasps.generator=runs/ffhnet/ffhnet_generator.safetensors \
--set grasps.evaluator=runs/ffhnet/ffhnet_evaluator.safetensors
"""


@command
def train(
    network: Annotated[
        str,
        typer.Argument(
            help="ffhnet, vfas, or ffhnet-evaluator: an evaluator tuned further on its own choices."
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for grasp data, checkpoints, weights, metrics.")
    ],
    objects: Annotated[
        int | None,
        typer.Option(
            min=6,
            help="Procedural objects, 63 or 72; the last nine, at most a third, are held out.",
        ),
    ] = None,
    tried: Annotated[
        int | None,
        typer.Option(
            min=12,
            help="ffhnet: grasps tried in physics per object, sampled, and as many proposed, 240; "
            "ffhnet-evaluator: proposed, 96.",
        ),
    ] = None,
    scenes: Annotated[
        int,
        typer.Option(min=1, help="vfas: views per object, each with 24 poses tried in physics."),
    ] = 16,
    views: Annotated[
        int | None,
        typer.Option(min=2, help="ffhnet: clouds per object, 100; ffhnet-evaluator: 60."),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=10,
            help="Of an evaluator, 6500 or 4000; of tuning further, 2500; FFHNet's generator takes "
            "16 for every 13.",
        ),
    ] = None,
    start: Annotated[
        Path | None,
        typer.Option(
            help="ffhnet-evaluator: file of the evaluator, with fingers, to tune; else the shipped."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of data, weights and batches.")] = 0,
    jobs: Annotated[
        int,
        typer.Option(min=1, help="Worker processes for the physics; results don't depend on it."),
    ] = 1,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Make grasps in physics, train the networks on them, calibrate, and measure on objects held
    out."""
    from rich.console import Console
    from rich.progress import Progress

    from dgeval.errors import UsageError

    if network not in ("ffhnet", "ffhnet-evaluator", "vfas"):
        hint = "ffhnet, ffhnet-evaluator or vfas"
        raise UsageError(f"no network {network!r} to train", hint=hint)
    if start is not None and network != "ffhnet-evaluator":
        raise UsageError("--start is of ffhnet-evaluator only")
    with Progress(console=Console(stderr=True), disable=json_ or not sys.stderr.isatty()) as bar:
        tasks: dict[str, TaskID] = {}
        totals: dict[str, int] = {}

        def progress(phase: str, step: int, terms: dict[str, float]) -> None:
            if phase not in tasks:
                tasks[phase] = bar.add_task(phase, total=totals[phase])
            text = ", ".join(f"{k} {v:.3f}" for k, v in terms.items())
            bar.update(
                tasks[phase], completed=step, description=f"{phase}: {text}" if text else phase
            )

        if network == "ffhnet":
            metrics = _ffhnet(
                out,
                objects or 63,
                tried or 240,
                views or 100,
                steps or 6500,
                seed,
                jobs,
                totals,
                progress,
            )
        elif network == "ffhnet-evaluator":
            from dgeval.networks.checkpoints import shipped
            from dgeval.training.ffhnet import Settings as EvaluatorSettings
            from dgeval.training.ship import tune_again

            objects, totals["tuning"] = objects or 63, steps or 2500
            tuning = EvaluatorSettings(
                views=views or 60,
                tune_steps=totals["tuning"],
                seed=seed,
                held_out=min(9, objects // 3),
            )
            first = start or shipped("ffhnet_evaluator_fingers.safetensors")
            metrics = tune_again(out, first, objects, tuning, tried or 96, jobs, progress)
        else:
            from dgeval.training.vfas import Settings, train_all

            objects, steps = objects or 72, steps or 4000
            totals.update(scenes=objects, evaluator=steps)
            settings = Settings(steps=steps, seed=seed, held_out=min(9, objects // 3))
            metrics = train_all(out, objects, settings, scenes, jobs, progress)
    if json_:
        print_json(metrics)
    else:
        for name, values in metrics["held_out"].items():
            typer.echo(f"{name}: " + ", ".join(f"{k} {v:.3f}" for k, v in values.items()))
        typer.echo(f"weights and metrics: {out}")


def _ffhnet(
    out: Path,
    objects: int,
    tried: int,
    views: int,
    steps: int,
    seed: int,
    jobs: int,
    totals: dict[str, int],
    progress: Progressed,
) -> dict[str, Any]:
    from dgeval.parallel import write_all
    from dgeval.training.ffhnet import Settings
    from dgeval.training.grasp_data import write_grasps
    from dgeval.training.ship import train_all

    step_counts = {"generator_steps": steps * 16 // 13, "tune_steps": steps * 5 // 13}
    totals.update(
        grasps=objects,
        generator=step_counts["generator_steps"],
        evaluator=steps,
        evaluator_fingers=steps,
    )
    totals["tuning"] = step_counts["tune_steps"]
    settings = Settings(
        views=views, steps=steps, seed=seed, held_out=min(9, objects // 3), **step_counts
    )
    counter = iter(range(1, objects + 1))
    make = partial(write_grasps, out=out / "grasps", seed=seed, tried=tried)
    write_all(make, range(objects), jobs, lambda _: progress("grasps", next(counter), {}))
    return train_all(out, objects, settings, tried, jobs, progress)
