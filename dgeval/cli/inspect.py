"""dgeval inspect: what a recording holds, what is damaged, and which questions it can answer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dgeval.cli.boundary import command, given_path, print_json
from dgeval.recording.check import PART_CHECK

if TYPE_CHECKING:
    from dgeval.config import Config

EXAMPLES = """\b
Examples:
  dgeval inspect apple.mcap
  dgeval inspect apple.mcap --json | jq .damage
  dgeval inspect apple.mcap --config > robot.toml
  dgeval inspect apple.mcap --hand-picture hand.png
"""


# s; a recorder so much later than the stamps has another clock's zero, and no delay
DAYS_OF_A_CLOCK_S = 1e8


@command
def inspect(
    path: Annotated[
        Path, typer.Argument(help="A recording.", metavar="RECORDING", parser=given_path)
    ],
    pipeline: Annotated[
        str, typer.Option(help="dynamic, or a FILE.toml whose roles and clocks apply.")
    ] = "dynamic",
    set_: Annotated[list[str] | None, typer.Option("--set", help="section.key=value.")] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
    config_: Annotated[
        bool, typer.Option("--config", help="Print a configuration with what was found, to edit.")
    ] = False,
    hand_picture: Annotated[
        Path | None,
        typer.Option(help="Draw the hand as its description has it, open and closed (PNG)."),
    ] = None,
) -> None:
    """Topics, roles found and missing, rates, gaps, colour–depth skew, clocks, damage; what can and
    can't be answered."""
    from dgeval.config import load_config
    from dgeval.determinism import limit_threads
    from dgeval.errors import EXIT_DATA_LOST, EXIT_OK
    from dgeval.recording.inspection import inspect_recording
    from dgeval.runs.target_told import foretold_target

    limit_threads()
    config = load_config(pipeline, tuple(set_ or ()))
    if config_:
        from dgeval.recording.found_config import found_config

        typer.echo(found_config(path, config), nl=False)
        return
    if hand_picture is not None:
        _draw_hand(path, config, hand_picture)
        return
    inspection = inspect_recording(path, config, foretold_target)
    failed = [c for c in inspection["checks"] if c["name"] not in config.checks.accept]
    refused = inspection["replay"].startswith("refused")
    code = EXIT_DATA_LOST if inspection["damage"] or failed or refused else EXIT_OK
    for damage in inspection["damage"]:
        typer.echo(f"damage: {damage}", err=True)
    if json_:
        print_json({**inspection, "exit_code": code})
    else:
        _print(inspection)
    raise typer.Exit(code)


def _draw_hand(path: Path, config: Config, out: Path) -> None:
    """Draw the hand of a recording. UsageError where its description has none."""
    from dgeval.errors import Place, UsageError
    from dgeval.recording.trials import find_trials, open_trial
    from dgeval.report.hand_picture import write_hand_picture
    from dgeval.robots.described_hand import DescribedHand

    robot = open_trial(find_trials([path])[0], config).robot
    hand = robot.hand_by_description
    if not isinstance(hand, DescribedHand):
        raise UsageError(f"no hand to draw: {hand}", Place(str(path)), "docs/hands.md")
    write_hand_picture(hand, out)
    typer.echo(f"{out}: {hand.told}")
    for note in robot.description.notes if robot.description is not None else ():
        typer.echo(f"note: {note}")


def _lacks_parts(inspection: dict[str, Any]) -> bool:
    return any(check["name"] == PART_CHECK for check in inspection.get("checks", ()))


def _print(inspection: dict[str, Any]) -> None:
    typer.echo(f"{inspection['file']}: {inspection['kind']}, {inspection['bytes'] / 1e6:.1f} MB")
    typer.echo(f"checksums: {inspection['checksums']}")
    typer.echo(
        "damage: "
        + (
            f"{len(inspection['damage'])} found, told above"
            if inspection["damage"]
            else "none found"
            + (", and parts are missing, told below" if _lacks_parts(inspection) else "")
        )
    )
    typer.echo("topics:")
    for topic in inspection["topics"]:
        rate = (
            f"{topic['rate_hz']:.1f} Hz, largest gap {topic['largest_gap_s']:.3f} s"
            if topic.get("rate_hz")
            else ""
        )
        image = f"  {topic['image']} frame {topic['frame_id']}" if "image" in topic else ""
        undecodable = f"  {topic['undecodable']} undecodable" if topic.get("undecodable") else ""
        typer.echo(
            f"  {topic['count']:6d}  {topic['name']}  ({topic['type']})  {rate}{image}{undecodable}"
        )
        if topic.get("unstamped"):
            typer.echo("          its headers bear no time: the recorder's is used")
        if topic.get("jitter_s") is not None and (
            abs(topic["recorder_delay_s"]) > 0.001 or abs(topic["drift_ppm"]) > 20
        ):
            delay = f"recorder {topic['recorder_delay_s']:+.4f} s after the header stamp"
            if topic["recorder_delay_s"] > DAYS_OF_A_CLOCK_S:
                delay += " (the header counts from a start, as simulated time does)"
            typer.echo(
                f"          {delay}, drift {topic['drift_ppm']:+.0f} ppm, "
                f"jitter {topic['jitter_s']:.4f} s"
            )
    typer.echo("roles:")
    for role, value in inspection["roles"].items():
        if role != "passed_over":
            shown = ", ".join(value) if isinstance(value, list) else value
            typer.echo(f"  {role}: {shown if shown is not None else 'not found'}")
    for role, names in inspection["roles"].get("passed_over", {}).items():
        typer.echo(f"  also possible as {role}: {', '.join(names)}")
    timing = inspection["timing"]
    if timing:
        typer.echo(
            f"pairs: {timing['pairs']} within {timing['tolerance_s'] * 1e3:.1f} ms, unmatched "
            f"{timing['unmatched_colour']} colour and {timing['unmatched_depth']} depth; skew "
            f"median {timing.get('skew_median_s', 0) * 1e3:+.2f} ms, largest "
            f"{timing.get('skew_largest_s', 0) * 1e3:.2f} ms"
        )
        for role in ("colour", "depth"):
            faults = {k: v for k, v in timing[f"{role}_stamps"].items() if k != "used" and v}
            if faults:
                typer.echo(f"  {role} stamps: " + ", ".join(f"{v} {k}" for k, v in faults.items()))
        if "proposal" in timing:
            typer.echo(f"  {timing['proposal']}")
    for event in inspection["events"]:
        label = event.get("label")
        said = f" {label}" if label in ("success", "failure") else ""
        after = f"{event['after_s']:+.2f} s, " if "after_s" in event else ""
        typer.echo(f"event: {event['event']}{said} at {after}{event['t_ns']} ns")
    checks = {f"check {c['name']}: {c['what']}; {c['mend']}" for c in inspection["checks"]}
    for note in (n for n in inspection["notes"] if n not in checks):
        typer.echo(f"note: {note}")
    for check in inspection["checks"]:
        typer.echo(f"check failed: {check['name']}: {check['what']}; {check['mend']}")
    for what in inspection["untested"]:
        typer.echo(f"nothing in the log tests {what}")
    typer.echo(f"replay: {inspection['replay']}")
    typer.echo("can it be told …")
    for answer in inspection["answers"]:
        missing = f": missing {', '.join(answer['missing'])}" if answer["missing"] else ""
        provided = f", if {answer['provided']}" if answer["can"] and answer["provided"] else ""
        word = "yes" if answer["can"] else "no "
        typer.echo(f"  {word}  {answer['question']}{missing}{provided}")
