"""dgeval regress: a data set against its baseline."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dgeval.cli.boundary import command, given_path, print_json

EXAMPLES = """\b
Examples:
  dgeval regress datasets/ci-smoke/ci-smoke.toml --baseline reports/baselines/ci-smoke.zip --jobs 2
  dgeval regress trials.toml --baseline main.zip --set registration.c_a_d=0.03
  dgeval regress trials.toml --baseline main.zip --update \
--reason "ICP search radius 30 mm, see #12"

Exit codes: 0 passed, or undecided with a warning (inconclusive; facts of the log told differently)
· 1 regression, or a baseline was written · 2 usage, a baseline of another data set or schema
· 3 recordings are damaged or not those of the baseline · 4 internal error.
"""


@command
def regress(
    dataset: Annotated[
        Path,
        typer.Argument(
            help="Manifest (.toml), recording or folder.", metavar="DATASET", parser=given_path
        ),
    ],
    baseline: Annotated[Path, typer.Option(help="Baseline file, as --update writes it.")],
    out: Annotated[
        Path, typer.Option(help="Folder of the run, junit.xml, regress.md, regress.html.")
    ] = Path("runs/regress"),
    pipeline: Annotated[
        str, typer.Option(help="dynamic, handover, vfas, or a FILE.toml with its parameters.")
    ] = "dynamic",
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="section.key=value, to try a change.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 1,
    update: Annotated[
        bool, typer.Option(help="Write the baseline instead of comparing. Never passes.")
    ] = False,
    reason: Annotated[
        str | None, typer.Option(help="Why the baseline is written; kept in it.")
    ] = None,
    fail_on: Annotated[
        str | None, typer.Option(help="`inconclusive`: that, and facts told differently, fail too.")
    ] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Replay a data set and hold it against a baseline: bytes first, then tolerances, then
    statistics over trials."""
    import json
    import os
    import tempfile

    from dgeval.compare.output import as_html, as_json, as_markdown
    from dgeval.compare.review import write_difference
    from dgeval.config import load_config
    from dgeval.errors import EXIT_OK, EXIT_WORSE, UsageError
    from dgeval.recording.containers.container import sha256_of
    from dgeval.recording.manifest import find_trials
    from dgeval.regress import (
        UNDECIDED,
        check_dataset,
        check_recordings,
        gate,
        junit,
        read_baseline,
        write_baseline,
    )
    from dgeval.runs.files import file_name, write_atomically
    from dgeval.runs.folder import finish_run
    from dgeval.runs.results import read_run
    from dgeval.runs.workers import replay_trials

    if fail_on not in (None, "inconclusive"):
        raise UsageError(f"--fail-on {fail_on!r}", hint="inconclusive is the only choice")
    if update and not reason:
        raise UsageError(
            "--update needs --reason", hint="say in a sentence why the results may change"
        )
    if reason and not update:
        raise UsageError("--reason is for --update")
    config = load_config(pipeline, tuple(set_ or ()))
    specs = find_trials([dataset], config.roles.events)
    name = dataset.stem

    def replay(hashes: dict[str, str] | None = None) -> int:
        def on_result(result: Any) -> None:
            for message in result.messages:
                typer.echo(f"{result.id}: {message}", err=True)

        # force=True: a finished trial in `out` may come from other code of the same version, and
        # such a change of code is what the gate is there to find
        results = replay_trials(specs, config, out, None, True, jobs, on_result, hashes=hashes)
        return finish_run(out, results, config)

    if update:
        _refuse_uncommitted()
        code = replay()
        if code != EXIT_OK:
            raise UsageError(
                "no baseline is made from a run in which something was lost",
                hint=f"see {out / 'log.jsonl'}",
            )
        write_baseline(baseline, out, name, specs, str(reason))
        typer.echo(
            f"baseline written: {baseline}; commit it, and run again to check against it", err=json_
        )
        if json_:
            print_json({"baseline": str(baseline), "written": True, "reason": reason})
        raise typer.Exit(EXIT_WORSE)
    with tempfile.TemporaryDirectory() as folder:
        about, before = read_baseline(baseline, Path(folder))
        check_dataset(about, name, specs, baseline)
        hashes = {s.id: sha256_of(s.recording, s.parts) for s in specs}
        check_recordings(about, hashes, baseline)
        code = replay(hashes)
        c, passed, message = gate(before, read_run(out), fail_on == "inconclusive")
        for field, a, b in c.config:
            typer.echo(f"config differs from the baseline's: {field}: {a} -> {b}", err=True)
        for d in c.differences:
            if not d.within:
                write_difference(
                    out / "changed" / f"{file_name(d.trial)}.rrd",
                    before.frames(d.trial),
                    c.new.frames(d.trial),
                    d,
                )
        write_atomically(out / "junit.xml", junit(c, passed, message, name))
        page = as_markdown(c)
        write_atomically(out / "regress.md", page)
        write_atomically(out / "regress.html", as_html(c))
        write_atomically(out / "regress.json", json.dumps(as_json(c), indent=1))
        if summary := os.environ.get("GITHUB_STEP_SUMMARY"):
            with Path(summary).open("a", encoding="utf-8") as file:
                file.write(page + "\n")
    if json_:
        print_json({**as_json(c), "passed": passed, "said": message})
    else:
        typer.echo(f"{'passed' if passed else 'FAILED'}: {c.conclusion}: {message}")
        for r in c.results:
            if r.answer in ("worse", "inconclusive", "better"):
                settle = f"; some {r.needed} trials would settle it" if r.needed else ""
                typer.echo(
                    f"  {r.metric.name}: {r.answer}, {r.old:.4g} -> {r.new:.4g} {r.metric.unit}, p "
                    f"= {r.p:.3f}{settle}"
                )
        if c.differences:
            typer.echo(f"look: {out / 'regress.html'}")
    if c.conclusion in UNDECIDED:
        typer.echo(f"warning: {c.conclusion}", err=True)
    raise typer.Exit(code if passed else EXIT_WORSE)


def _refuse_uncommitted() -> None:
    """UsageError where git reports uncommitted changes: a baseline belongs to a commit.

    Outside a repository, or without git, nothing is refused.
    """
    import subprocess

    from dgeval.errors import UsageError

    try:
        status = subprocess.run(
            ["git", "status", "--porcelain"], capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        return
    if status.returncode == 0 and status.stdout.strip():
        first = status.stdout.splitlines()[0].strip()
        raise UsageError(
            f"there are uncommitted changes ({first}, …)",
            hint="commit first: a baseline belongs to a commit",
        )
