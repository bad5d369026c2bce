"""dgeval replay: recordings through the pipeline, frame by frame, into a run folder."""

from __future__ import annotations

import sys
from dataclasses import replace as with_fields
from pathlib import Path
from typing import Annotated, Any

import typer

from dgeval.cli.boundary import command, given_path, print_json

MOST_WITH_NOTES = 6  # trials, of more the notes are not printed but stand in the tables; ours
EXAMPLES = """\b
Examples:
  dgeval replay apple.mcap --bbox 430,342,524,432
  dgeval replay apple.mcap --close +3.2 --label failure
  dgeval replay trials.toml --out runs/monday --jobs 4
  dgeval replay night/ --set registration.method=open3d --no-review
  dgeval replay night/ --out runs/again --estimates runs/night/estimates.json
"""


@command
def replay(
    paths: Annotated[
        list[Path],
        typer.Argument(
            help="Recordings, folders of recordings, manifests (.toml).",
            metavar="PATH…",
            parser=given_path,
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Run folder. A finished trial in it is not done again.")
    ] = Path("runs/latest"),
    pipeline: Annotated[
        str, typer.Option(help="dynamic, handover, vfas, or a FILE.toml with its parameters.")
    ] = "dynamic",
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="section.key=value; see `dgeval config show`.")
    ] = None,
    bbox: Annotated[
        str | None, typer.Option(help="Target box x0,y0,x1,y1 in px. Needs exactly one trial.")
    ] = None,
    bbox_time: Annotated[
        int | None, typer.Option(help="Time of the box, ns; default: the first frame.")
    ] = None,
    frames: Annotated[
        str | None, typer.Option(help="A:B, paired frames to use. Needs exactly one trial.")
    ] = None,
    close: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="When the hand was told to close: +3.2 s after the first frame, or a stamp such "
            "as 1800000003.2. Needs exactly one trial.",
        ),
    ] = None,
    lift: Annotated[
        str | None, typer.Option(metavar="TIME", help="When it was told to lift, likewise.")
    ] = None,
    label: Annotated[
        str | None, typer.Option(help="success or failure, as you saw it. Needs exactly one trial.")
    ] = None,
    estimates: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="estimates.json of another run: how the hand closes, and where it comes to rest "
            "on nothing, as other trials show it.",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 1,
    review: Annotated[
        bool, typer.Option("--review/--no-review", help="Write a Rerun recording per trial.")
    ] = True,
    check_determinism: Annotated[
        bool, typer.Option(help="Replay twice, compare the digests of every stage.")
    ] = False,
    force: Annotated[bool, typer.Option(help="Do finished trials again.")] = False,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output, nothing else.")
    ] = False,
) -> None:
    """Replay recordings through the perception and control stages and write tables and review
    recordings."""
    from dgeval.config import load_config
    from dgeval.errors import UsageError
    from dgeval.recording.manifest import find_trials
    from dgeval.runs.estimates import read_estimates
    from dgeval.runs.folder import TrialResult, finish_run
    from dgeval.runs.workers import replay_trials

    config = load_config(pipeline, tuple(set_ or ()))
    specs = find_trials(paths, config.roles.events)
    given = None if estimates is None else read_estimates(estimates)
    if (bbox or frames or bbox_time) and len(specs) != 1:
        raise UsageError(
            f"--bbox and --frames need exactly one trial, there are {len(specs)}",
            hint="use a manifest",
        )
    if bbox:
        specs = [with_fields(specs[0], bbox=_numbers(bbox, 4, "--bbox"), bbox_time_ns=bbox_time)]
    if frames:
        specs = [with_fields(specs[0], frames=_range(frames))]
    overrides = {**_moment("close", close), **_moment("lift", lift), **_label(label)}
    if overrides and len(specs) != 1:
        raise UsageError(
            f"--close, --lift and --label need exactly one trial, there are {len(specs)}",
            hint="use a manifest with close_ns, lift_ns or label",
        )
    if overrides:
        specs = [with_fields(specs[0], **overrides)]

    def on_result(result: TrialResult) -> None:
        for message in result.messages:
            typer.echo(f"{result.id}: {message}", err=True)

    writer = None
    if review:
        from dgeval.rerun_view import ReviewWriter

        writer = ReviewWriter
    with _progress(len(specs)) as bar:
        results = replay_trials(
            specs,
            config,
            out,
            writer,
            force,
            jobs,
            on_result=_call_both(on_result, bar.trial),
            progress=bar.frame,
            estimates=given,
        )
    code = finish_run(out, results, config)
    if check_determinism:
        _check_determinism(specs, config, jobs, results, given)
    if json_:
        print_json(
            {
                "run": str(out),
                "exit_code": code,
                "trials": [
                    {**(r.row or {"trial": r.id}), "exit_code": r.exit_code, "messages": r.messages}
                    for r in results
                ],
            }
        )
    else:
        _print_summary(out, results, review)
    raise typer.Exit(code)


def _moment(name: str, text: str | None) -> dict[str, Any]:
    """Fields of a trial for a time such as +3.2 (s after the first frame) or 1800000003.2 (s)."""
    from decimal import Decimal, InvalidOperation

    from dgeval.errors import UsageError

    if text is None:
        return {}
    hint = "give +3.2, or a stamp in s such as 1800000003.2"
    try:
        value = Decimal(text)
    except InvalidOperation as error:
        raise UsageError(f"--{name} {text!r} is no time", hint=hint) from error
    if not value.is_finite():
        raise UsageError(f"--{name} {text!r} is no time", hint=hint)
    if text.strip().startswith(("+", "-")) or value < 1_000_000:
        return {f"{name}_after_s": float(value)}
    return {f"{name}_ns": int(value * 1_000_000_000)}


def _label(text: str | None) -> dict[str, Any]:
    from dgeval.errors import UsageError
    from dgeval.recording.contract import label_of

    if text is None:
        return {}
    label = label_of(text)
    if label is None:
        raise UsageError(f"--label {text!r} is neither success nor failure")
    return {"label": label}


def _check_determinism(specs: Any, config: Any, jobs: int, results: Any, estimates: Any) -> None:
    """Replay the trials again into a temporary folder and compare the digests of every stage.

    NotDeterministicError where a digest differs.
    """
    import tempfile

    from dgeval.errors import NotDeterministicError
    from dgeval.runs.workers import replay_trials
    from dgeval.schema import STAGES

    hashes = {r.id: r.sha256 for r in results if r.sha256 is not None}
    with tempfile.TemporaryDirectory() as folder:
        repeated = replay_trials(
            specs,
            config,
            Path(folder),
            None,
            True,
            jobs,
            on_result=lambda _: None,
            hashes=hashes,
            estimates=estimates,
        )
    for first, second in zip(results, repeated, strict=True):
        if (first.row is None) != (second.row is None):
            raise NotDeterministicError(f"trial {first.id} could be replayed once only")
        if first.row is None or second.row is None:
            continue
        for stage in STAGES:
            if first.row[f"digest_{stage}"] != second.row[f"digest_{stage}"]:
                raise NotDeterministicError(
                    f"trial {first.id}: stage {stage} gave other results the second time"
                )
    typer.echo("determinism: every stage of every trial gave the same bytes twice", err=True)


def _print_summary(out: Path, results: Any, review: bool) -> None:
    from dgeval.schema import notes_of

    for r in results:
        if r.row is None:
            typer.echo(f"{r.id}: not replayed")
            continue
        row = r.row
        kept = " (kept from before)" if r.resumed else ""
        parts = f"{row['n_frames']} frames, {row['n_lost']} lost, {row['n_predicted']} predicted"
        typer.echo(f"{r.id}: {row['outcome']}, {parts}{kept}")
        typer.echo(f"  {row['evidence']}")
        for note in notes_of(row["notes"]) if len(results) <= MOST_WITH_NOTES else ():
            if note not in r.messages:  # said on standard error
                typer.echo(f"  note: {note}")
        if r.review:
            size = (
                f"{r.review['bytes'] / 1e6:.1f} MB, the colour images alone "
                f"{r.review['image_bytes'] / 1e6:.1f} MB"
            )
            typer.echo(f"  review: {size}")
    if len(results) > MOST_WITH_NOTES:
        typer.echo(f"notes of each: dgeval show {out} TRIAL")
    typer.echo(f"tables: {out}")
    if review and any(r.row for r in results):
        typer.echo(
            f"look: dgeval view {out} {next(r.id for r in results if r.row)}    dgeval report {out}"
        )


def _numbers(text: str, count: int, option: str) -> Any:
    from dgeval.errors import UsageError

    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or values[0] >= values[2] or values[1] >= values[3]:
        raise UsageError(f"{option} {text!r} is not x0,y0,x1,y1 with x0 < x1 and y0 < y1")
    return values


def _range(text: str) -> tuple[int, int]:
    from dgeval.errors import UsageError

    a, _, b = text.partition(":")
    if not (a.isdecimal() and b.isdecimal() and int(a) < int(b)):
        raise UsageError(f"--frames {text!r} is not A:B with A < B")
    return int(a), int(b)


def _call_both(first: Any, second: Any) -> Any:
    def call(result: Any) -> None:
        first(result)
        second(result)

    return call


class _progress:
    """Progress bars on standard error: frames within a trial, and trials.

    Silent where standard error is not a terminal.
    """

    def __init__(self, n_trials: int) -> None:
        self._n = n_trials

    def __enter__(self) -> _progress:
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(
            console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True
        )
        self._bar.start()
        self._trials = self._bar.add_task("trials", total=self._n, visible=self._n > 1)
        self._frames = self._bar.add_task("frames", total=None)
        return self

    def frame(self, done: int, total: int) -> None:
        self._bar.update(self._frames, completed=done, total=total)

    def trial(self, _: Any) -> None:
        self._bar.advance(self._trials)

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
