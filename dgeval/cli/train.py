"""dgeval train: the networks that ship with dgeval, made again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgeval.cli.boundary import command, print_json

EXAMPLES = """\b
Examples:
  dgeval train ffhnet --out runs/ffhnet --jobs 2        (more than an hour on two cores)
  dgeval train ffhnet --out runs/quick --objects 18 --tried 60 --views 20 --steps 200

Stopped runs go on where they were. Use what comes out with
  dgeval replay … --set grasps.generator=runs/ffhnet/ffhnet_generator.safetensors \
--set grasps.evaluator=runs/ffhnet/ffhnet_evaluator.safetensors
"""


@command
def train(
    network: Annotated[str, typer.Argument(help="ffhnet.")],
    out: Annotated[Path, typer.Option(help="Folder for grasp data, checkpoints, weights, metrics.")],
    objects: Annotated[int, typer.Option(min=6, help="Procedural objects; the last nine, at most a third, are held out.")] = 63,
    tried: Annotated[
        int, typer.Option(min=12, help="Grasps tried in physics per object, sampled, and as many proposed.")
    ] = 240,
    views: Annotated[int, typer.Option(min=2, help="Clouds per object.")] = 100,
    steps: Annotated[int, typer.Option(min=10, help="Steps of an evaluator; the generator takes 8 for every 3.")] = 3000,
    seed: Annotated[int, typer.Option(min=0, help="Of data, weights and batches.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes for the physics; results don't depend on it.")] = 1,
    json_: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Make grasps in physics, train generator and evaluators on them, calibrate, and measure on objects held out."""
    from rich.console import Console
    from rich.progress import Progress

    from dgeval.errors import UsageError
    from dgeval.training.ffhnet import Settings
    from dgeval.training.grasp_data import write_all
    from dgeval.training.ship import train_all

    if network != "ffhnet":
        raise UsageError(f"no network {network!r} to train", hint="ffhnet is the only one")
    settings = Settings(views=views, steps=steps, generator_steps=steps * 8 // 3, seed=seed, held_out=min(9, objects // 3))
    with Progress(console=Console(stderr=True), disable=json_) as bar:
        task = bar.add_task("grasps in physics", total=objects)
        write_all(out / "grasps", objects, seed, tried, jobs, lambda _: bar.advance(task))
        tasks = {}

        def progress(kind: str, step: int, terms: dict[str, float]) -> None:
            if kind not in tasks:
                tasks[kind] = bar.add_task(kind, total=steps * 8 // 3 if kind == "generator" else steps)
            said = ", ".join(f"{k} {v:.3f}" for k, v in terms.items())
            bar.update(tasks[kind], completed=step, description=f"{kind}: {said}")

        metrics = train_all(out, objects, settings, tried, jobs, progress)
    if json_:
        print_json(metrics)
    else:
        for name, values in metrics["held_out"].items():
            typer.echo(f"{name}: " + ", ".join(f"{k} {v:.3f}" for k, v in values.items()))
        typer.echo(f"weights and metrics: {out}")
