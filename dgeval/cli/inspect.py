"""dgeval inspect: what a recording holds, what is damaged, and which questions it can answer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dgeval.cli.boundary import command, print_json

EXAMPLES = """\b
Examples:
  dgeval inspect apple.mcap
  dgeval inspect apple.mcap --json | jq .damage
"""


@command
def inspect(
    path: Annotated[Path, typer.Argument(help="A recording.")],
    pipeline: Annotated[
        str, typer.Option(help="dynamic, or a FILE.toml whose roles and clocks apply.")
    ] = "dynamic",
    set_: Annotated[list[str] | None, typer.Option("--set", help="section.key=value.")] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Topics, roles found and missing, rates, gaps, colour–depth skew, clocks, damage; what can and can't be answered."""
    from dgeval.config import load_config
    from dgeval.errors import EXIT_DATA_LOST, EXIT_OK
    from dgeval.recording.inspection import inspect_recording

    found = inspect_recording(path, load_config(pipeline, tuple(set_ or ())))
    code = EXIT_DATA_LOST if found["damage"] else EXIT_OK
    for damage in found["damage"]:
        typer.echo(f"damage: {damage}", err=True)
    if json_:
        print_json({**found, "exit_code": code})
    else:
        _print(found)
    raise typer.Exit(code)


def _print(found: dict[str, Any]) -> None:
    typer.echo(f"{found['file']}: {found['kind']}, {found['bytes'] / 1e6:.1f} MB")
    typer.echo(f"checksums: {found['checksums']}")
    typer.echo(
        "damage: "
        + (f"{len(found['damage'])} found, told above" if found["damage"] else "none found")
    )
    typer.echo("topics:")
    for t in found["topics"]:
        rate = (
            f"{t['rate_hz']:.1f} Hz, largest gap {t['largest_gap_s']:.3f} s"
            if t.get("rate_hz")
            else ""
        )
        image = f"  {t['image']} frame {t['frame_id']}" if "image" in t else ""
        bad = f"  {t['undecodable']} undecodable" if t.get("undecodable") else ""
        typer.echo(f"  {t['count']:6d}  {t['name']}  ({t['type']})  {rate}{image}{bad}")
        if t.get("jitter_s") is not None and (
            abs(t["recorder_delay_s"]) > 0.001 or abs(t["drift_ppm"]) > 20
        ):
            delay = f"recorder {t['recorder_delay_s']:+.4f} s after the header stamp"
            typer.echo(
                f"          {delay}, drift {t['drift_ppm']:+.0f} ppm, jitter {t['jitter_s']:.4f} s"
            )
    typer.echo("roles:")
    for role, value in found["roles"].items():
        if role != "passed_over":
            typer.echo(f"  {role}: {value if value is not None else 'not found'}")
    for role, names in found["roles"].get("passed_over", {}).items():
        typer.echo(f"  also possible as {role}: {', '.join(names)}")
    timing = found["timing"]
    if timing:
        typer.echo(
            f"pairs: {timing['pairs']} within {timing['tolerance_s'] * 1e3:.1f} ms, unmatched "
            f"{timing['unmatched_colour']} colour and {timing['unmatched_depth']} depth; skew "
            f"median {timing.get('skew_median_s', 0) * 1e3:+.2f} ms, largest "
            f"{timing.get('skew_largest_s', 0) * 1e3:.2f} ms"
        )
        for role in ("colour", "depth"):
            wrong = {k: v for k, v in timing[f"{role}_stamps"].items() if k != "used" and v}
            if wrong:
                typer.echo(f"  {role} stamps: " + ", ".join(f"{v} {k}" for k, v in wrong.items()))
        if "proposal" in timing:
            typer.echo(f"  {timing['proposal']}")
    for event in found["events"]:
        typer.echo(f"event: {event['event']} at {event['t_ns']} ns")
    for note in found["notes"]:
        typer.echo(f"note: {note}")
    typer.echo("can it be told …")
    for a in found["answers"]:
        missing = f": missing {', '.join(a['missing'])}" if a["missing"] else ""
        typer.echo(f"  {'yes' if a['can'] else 'no '}  {a['question']}{missing}")
