"""The damage campaign: every container with every mutation, each in a child process with limits.

Outcomes are counted in a Markdown table. It catches what the selection in test_damage.py is too
small to find: a reader that gives wrong or fewer messages and doesn't report it, foreign
exceptions, hangs, memory out of proportion, tracebacks and wrong exit codes of the command line.

    python tests/soak/damage_campaign.py --seeds 200 --out damage.md
"""

from __future__ import annotations

import argparse
import itertools
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "recording"))

import damage as d
import dgeval.recording.inspection
import dgeval.runs.trial_job
import dgeval.runs.workers  # noqa: F401
from dgeval.cli import app  # noqa: F401

PEAK_MB = 1024  # MB of resident memory of a child; more is a violation


class Report:
    """Counts by container and mutation, and every violation with the case that shows it."""

    def __init__(self) -> None:
        self.counts: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
        self.violations: list[str] = []
        self.samples: dict[tuple[str, str, str], str] = {}
        self.slowest = (0.0, "")
        self.largest = (0.0, "")

    def add(self, container: str, row: str, detail: str, outcome: d.Outcome) -> None:
        self.counts[container, row][outcome.kind] += 1
        name = f"{container} / {row} / {detail}"
        if outcome.kind == d.VIOLATION:
            self.violations.append(f"{name}: {outcome.detail}")
        self.samples.setdefault((container, row, outcome.kind), f"{detail}: {outcome.detail}")
        self.slowest = max(self.slowest, (outcome.seconds, name))
        self.largest = max(self.largest, (outcome.peak_mb, name))

    def by_signature(self) -> str:
        """Violations that differ in numbers only, counted, with the first of each."""
        groups: dict[str, list[str]] = defaultdict(list)
        for line in self.violations:
            groups[
                re.sub(r"[0-9]+", "N", line.split(": ", 1)[1] if " / " in line else line)[:90]
            ].append(line)
        return "\n".join(
            f"{len(v):4d}  {v[0][:600]}" for v in sorted(groups.values(), key=len, reverse=True)
        )

    def table(self, containers: set[str] | None = None) -> str:
        kinds = [
            k
            for k in (*d.OUTCOMES, "exit 0", "exit 2", "exit 3", d.STDOUT_ONLY)
            if any(c[k] for c in self.counts.values())
        ]
        lines = [
            "| container | mutation | " + " | ".join(kinds) + " |",
            "|---|---|" + "---:|" * len(kinds),
        ]
        total: Counter[str] = Counter()
        for (container, row), count in sorted(self.counts.items()):
            if containers is None or container in containers:
                lines.append(
                    f"| {container} | {row} | "
                    + " | ".join(str(count[k] or "") for k in kinds)
                    + " |"
                )
                total += count
        lines.append("| **all** | | " + " | ".join(f"**{total[k]}**" for k in kinds) + " |")
        return "\n".join(lines)


def damage_bytes(
    report: Report, kinds: list[d.Kind], seeds: int, cli_every: int, scratch: Path
) -> None:
    """Mutations of bytes: the reader on all, the command line on every n-th of each row."""
    for kind in kinds:
        good = d.make_good(kind, _fresh(scratch, kind.name.replace(" ", "-").replace(",", "")))
        cases_done: Counter[str] = Counter()
        for batch in _batches(d.cases(good, seeds), 40):
            paths = [
                d.place_case(good, case, _fresh(scratch, f"case{i}"))
                for i, case in enumerate(batch)
            ]
            outcomes = d.in_children(
                [partial(d.read_outcome, p, good.messages, kind.checked) for p in paths]
            )
            for case, path, outcome in zip(batch, paths, outcomes, strict=True):
                report.add(kind.name, case.mutation, case.detail, outcome)
                cases_done[case.mutation] += 1
                if cli_every and cases_done[case.mutation] % cli_every == min(1, cli_every - 1):
                    _through_cli(report, kind, case, path, outcome, scratch)
        print(f"{kind.name}: {sum(cases_done.values())} cases", file=sys.stderr, flush=True)


def _batches(items: Iterable[d.Case], size: int) -> Iterator[list[d.Case]]:
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, size)):
        yield batch


def _through_cli(
    report: Report, kind: d.Kind, case: d.Case, path: Path, outcome: d.Outcome, scratch: Path
) -> None:
    intact: bool | None = None
    if outcome.kind in (d.COMPLETE_REPORTED, d.PREFIX, d.ERROR, d.OTHER_ORDER, d.CHANGED_REPORTED):
        intact = False
    elif outcome.kind == d.COMPLETE:
        intact = True
    for command in ("inspect", "replay"):
        result = d.in_child(
            lambda c=command: _cli(c, path, intact, scratch), seconds=60, extra_mb=3000
        )
        report.add(
            f"cli {command}, {kind.layout}", case.mutation, f"{kind.name}, {case.detail}", result
        )


def _cli(command: str, path: Path, intact: bool | None, scratch: Path) -> d.Outcome:
    out = _fresh(scratch, "run")
    arguments = [command, str(path)]
    if command == "replay":
        arguments += ["--bbox", "10,10,40,40", "--out", str(out), "--no-review", *d.NO_TARGET]
    return d.judge_cli(*d.run_cli(arguments), path.name, intact)


def _cli_new(path: Path, scratch: Path) -> d.Outcome:
    out = _fresh(scratch, "run") / "new"
    return d.judge_cli(
        *d.run_cli(["replay", str(path), "--out", str(out), "--no-review", *d.NO_TARGET]),
        path.name,
        False,
    )


def bombs(report: Report, scratch: Path) -> None:
    """A chunk that claims 1000 bytes and expands to 1.75 GB."""
    for compression in ("zstd", "lz4"):
        path = _fresh(scratch, "bomb") / "bomb.mcap"
        path.write_bytes(d.bomb(compression, 7 << 28))
        outcome = d.in_child(lambda p=path: d.read_outcome(p, [], "chunk"), extra_mb=6000)
        if outcome.kind != d.VIOLATION and outcome.peak_mb > PEAK_MB:
            outcome.detail = (
                f"{outcome.peak_mb:.0f} MB resident for a file of {path.stat().st_size} bytes; "
                f"{outcome.detail}"
            )
            outcome.kind = d.VIOLATION
        report.add(f"mcap {compression}", "bomb", "1000 bytes claimed, 1.75 GiB inside", outcome)


def contents(report: Report, containers: tuple[str, ...], scratch: Path) -> list[str]:
    """Wrong contents in intact files, through the command line.

    Returns one line of a Markdown table per case and command, with exit code and message.
    """
    lines = []
    for container in containers:
        for case in d.SEMANTIC:
            folder = _fresh(scratch, "case")
            try:
                path = d.write_semantic(case, container, folder)
            except Exception as error:  # a value that this container can't hold
                lines.append(
                    f"| {container} | {case.name} | not writable: {type(error).__name__} | |"
                )
                continue
            for command in ("inspect", "replay"):
                outcome = d.in_child(
                    lambda k=case, p=path, c=command: d.semantic_outcome(
                        k, p, c, _fresh(scratch, "run")
                    ),
                    seconds=60,
                    extra_mb=3000,
                )
                report.add(f"contents {command}, {container}", "contents", case.name, outcome)
                message = (
                    (outcome.lines[1:] or [""])[-1]
                    .replace("|", "/")
                    .replace(str(scratch), "…")[:220]
                )
                mark = "**VIOLATION** " if outcome.kind == d.VIOLATION else ""
                lines.append(
                    f"| {container} | {case.name} | {command} {mark}{(outcome.lines or ['-'])[0]} "
                    f"| {message} |"
                )
    return lines


def real_processes(report: Report, kinds: list[d.Kind], scratch: Path) -> None:
    """A few cases through `python -m dgeval` itself.

    Catches a difference between it and the command line that runs in the campaign's process.
    """
    for kind in kinds:
        good = d.make_good(kind, _fresh(scratch, "real"))
        for case in [
            c
            for c in d.cases(good, 1)
            if c.mutation in ("cut", "LFS pointer", "empty") and "last" not in c.detail
        ][:3]:
            path = d.place_case(good, case, _fresh(scratch, "case"))
            command = [sys.executable, "-m", "dgeval", "inspect", str(path)]
            done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
            outcome = d.judge_cli(done.returncode, done.stdout, done.stderr, path.name, None)
            report.add(
                "python -m dgeval inspect", case.mutation, f"{kind.name}, {case.detail}", outcome
            )


def _fresh(scratch: Path, name: str) -> Path:
    import shutil

    path = scratch / name
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir(parents=True)
    return path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--seeds",
        type=int,
        default=100,
        help="single bit flips per container; a tenth of it for other random cases",
    )
    parser.add_argument("--out", type=Path, help="Markdown file for the tables")
    parser.add_argument("--only", default="", help="containers whose name contains this")
    parser.add_argument(
        "--parts", default="bytes,bombs,contents,real", help="parts of the campaign, comma between"
    )
    parser.add_argument(
        "--cli-every",
        type=int,
        default=1000,
        help="every n-th case of a mutation goes through the command line too",
    )
    parser.add_argument(
        "--containers", default="mcap,bag,db3", help="containers of the wrong contents"
    )
    args = parser.parse_args()
    started = time.perf_counter()
    kinds = [k for k in d.KINDS if args.only in k.name]
    report = Report()
    d.parse_definitions_once()
    lines: list[str] = []
    with tempfile.TemporaryDirectory(prefix="damage-") as folder:
        scratch = Path(folder)
        parts = args.parts.split(",")
        if "bytes" in parts:
            damage_bytes(report, kinds, args.seeds, args.cli_every, scratch)
        if "bombs" in parts:
            bombs(report, scratch)
        if "contents" in parts:
            path = d.write_semantic(
                next(c for c in d.SEMANTIC if c.name == "no depth"), "mcap", _fresh(scratch, "case")
            )
            report.add(
                "contents replay, mcap",
                "run folder is new",
                "no depth",
                d.in_child(lambda: _cli_new(path, scratch)),
            )
            lines = contents(report, tuple(args.containers.split(",")), scratch)
        if "real" in parts:
            real_processes(
                report,
                [k for k in kinds if k.name in ("mcap zstd", "bag none", "db3 folder")],
                scratch,
            )
    n = sum(sum(c.values()) for c in report.counts.values())
    out = [
        f"# Damage campaign: {n} cases, {args.seeds} seeds, {len(report.violations)} violations",
        "",
    ]
    out += [report.table(), "", f"slowest: {report.slowest[0]:.1f} s, {report.slowest[1]}", ""]
    out += [f"largest: {report.largest[0]:.0f} MB resident, {report.largest[1]}", ""]
    if lines:
        out += [
            "## Wrong contents",
            "",
            "| container | contents | result | last line on standard error |",
            "|---|---|---|---|",
            *lines,
            "",
        ]
    out += ["## Violations", "", *(f"- {v}" for v in report.violations or ["none"]), ""]
    out += [
        "## A sample of each outcome",
        "",
        *(f"- {c} / {r} / {k}: {text}" for (c, r, k), text in sorted(report.samples.items())),
    ]
    text = (
        "\n".join(out).replace(str(scratch), "…") + f"\n\n{time.perf_counter() - started:.0f} s\n"
    )
    print(text)
    if args.out:
        args.out.write_text(text, encoding="utf-8")
    print(report.by_signature(), file=sys.stderr)
    return 1 if report.violations else 0


if __name__ == "__main__":
    sys.exit(main())
