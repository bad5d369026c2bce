"""dgeval simulate: physics trials with ground truth, recorded like real logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dgeval.cli.boundary import command, print_json

EXAMPLES = """\b
Examples:
  dgeval simulate conveyor --out runs/belt --jobs 2
  dgeval simulate static --trials 4 --meshes scans/ --seed 7
  dgeval simulate my.toml --no-images --blame      (truth only, no recordings)
  dgeval simulate datasets/failures.toml           (the recordings a manifest was made from)
  dgeval simulate failures --hand my_gripper.toml --stranger
                                                   (another hand, logged as its robot would)
"""


@command
def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            help="conveyor, handover, conveyor-analytic, static, failures, ci-smoke, "
            "table-clearing, turntable, vfas-handover, a FILE.toml, or a manifest."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder; finished trials in it are kept. Default runs/SCENARIO."),
    ] = None,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Number of trials; default: the scenario's.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, other trials.")] = 0,
    jobs: Annotated[
        int, typer.Option(min=1, help="Worker processes; results don't depend on it.")
    ] = 1,
    meshes: Annotated[
        Path | None, typer.Option(help="Folder of meshes (m, z up) in place of the ten objects.")
    ] = None,
    format_: Annotated[
        str, typer.Option("--format", help="mcap, bag (ROS 1) or db3 (ROS 2 folder).")
    ] = "mcap",
    blame: Annotated[
        bool,
        typer.Option("--blame", help="Find the injected fault whose removal restores success."),
    ] = False,
    hand: Annotated[
        Path | None,
        typer.Option(
            help="A hand's URDF, or a TOML that says more of it (docs/hands.md), on the same arm."
        ),
    ] = None,
    stranger: Annotated[
        bool,
        typer.Option(
            "--stranger",
            help="Record as another robot would: no topic of dgeval's, into OUT/recordings; the "
            "truth is in OUT/truth.",
        ),
    ] = False,
    images: Annotated[
        bool,
        typer.Option(
            "--images/--no-images", help="Render and write recordings, or the truth alone."
        ),
    ] = True,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output, nothing else.")
    ] = False,
) -> None:
    """Simulate grasping trials with faults on purpose; write recordings, what is true of them, and
    a manifest."""
    from dgeval.errors import UsageError
    from dgeval.simulation.campaign import (
        Campaign,
        platform_name,
        run_campaign,
        unstable_trials,
    )
    from dgeval.simulation.hand_grasps import without_grasps
    from dgeval.simulation.imported_hand import ImportedHand
    from dgeval.simulation.scenario import load_manifest, load_scenario, with_hand

    if format_ not in ("mcap", "bag", "db3"):
        raise UsageError(f"--format {format_!r}", hint="mcap, bag or db3")
    manifest = load_manifest(Path(scenario)) if scenario.endswith(".toml") else None
    loaded = load_scenario(manifest.scenario if manifest else scenario)
    if hand is not None:
        loaded = with_hand(loaded, hand)
    gripper = loaded.gripper
    given = gripper.sha256 if isinstance(gripper, ImportedHand) else None
    if manifest is not None and manifest.hand_sha256 != given:
        raise UsageError(
            "the manifest was made with another hand", hint="give its file with --hand"
        )
    folder = out or Path("runs") / loaded.name
    campaign = Campaign(
        loaded,
        manifest.seed if manifest else seed,
        trials or loaded.trials,
        folder,
        meshes,
        blame,
        tuple(manifest.indices) if manifest else None,
        images,
        format_,
        stranger,
    )
    with campaign_progress() as progress:
        pairs = run_campaign(campaign, jobs, progress)
    differences = []
    if manifest is not None:
        sha256_of = {r["id"]: r["sha256"] for _, r in pairs if r}
        differences = [
            f"{i}: not the recording the manifest names"
            for i, sha in manifest.sha256.items()
            if sha256_of.get(i, sha) != sha
        ]
    same_platform = manifest is not None and manifest.platform == platform_name()
    if json_:
        print_json(
            {
                "out": str(folder),
                "trials": [{**t, "recording": r} for t, r in pairs],
                "differences": differences,
            }
        )
        raise typer.Exit(3 if differences and same_platform else 0)
    _summary(pairs, campaign)
    if unstable := unstable_trials(folder):
        typer.echo(f"left out, as their physics was unstable: {', '.join(unstable)}")
    if isinstance(gripper, ImportedHand) and (left := without_grasps(folder / "grasps")):
        typer.echo(f"left out, as the hand was found not to hold them: {', '.join(left)}")
    if isinstance(gripper, ImportedHand) and images:
        named = ", ".join(f'"{folder}"' for folder in gripper.mesh_dirs)
        typer.echo(f"its meshes: --set 'calibration.mesh_dirs=[{named}]'")
    for line in differences:
        typer.echo(
            f"{'error' if same_platform else 'warning (another platform)'}: {line}", err=True
        )
    raise typer.Exit(3 if differences and same_platform else 0)


def _summary(pairs: Any, campaign: Any) -> None:
    kinds: dict[str, int] = {}
    for truth, _ in pairs:
        kind = truth["verdict"]["failure_class"] or truth["verdict"]["outcome"]
        kinds[kind] = kinds.get(kind, 0) + 1
    typer.echo(
        f"{len(pairs)} trials: " + ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
    )
    if campaign.images:
        size = sum(r["bytes"] for _, r in pairs if r) / 1e6
        name = "" if campaign.stranger else f"{campaign.scenario.name}.toml"
        typer.echo(f"recordings: {campaign.recordings} ({size:.0f} MB)")
        replayed = f"dgeval replay {campaign.recordings / name} --out {campaign.out}/replay"
        typer.echo(f"next: {replayed}")
    if campaign.stranger or not campaign.images:
        typer.echo(f"truth: {campaign.out}/truth")


def campaign_progress() -> Any:
    """A progress bar per phase where standard error is a terminal, else a line per trial."""
    from contextlib import contextmanager

    @contextmanager
    def bars() -> Any:
        import sys

        if not sys.stderr.isatty():

            def line(phase: str, done: int, total: int, result: dict[str, Any]) -> None:
                outcome = ""
                if phase == "simulate":
                    verdict = result["verdict"]
                    outcome = f": {verdict['failure_class'] or verdict['outcome']}"
                elif phase == "grasps":
                    outcome = f": {result['count']}"
                typer.echo(f"{phase} {done}/{total} {result['id']}{outcome}", err=True)

            yield line
            return
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True)) as progress:
            tasks: dict[str, Any] = {}

            def step(phase: str, done: int, total: int, _: dict[str, Any]) -> None:
                if phase not in tasks or done == 1:
                    tasks[phase] = progress.add_task(phase, total=total)
                progress.update(tasks[phase], completed=done)

            yield step

    return bars()
