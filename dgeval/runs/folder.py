"""The end of a run: tables joined from its trials, run.json, and the exit code."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from dgeval import __version__
from dgeval.config import Config
from dgeval.determinism import fingerprint
from dgeval.errors import EXIT_DATA_LOST, EXIT_INTERNAL, EXIT_OK, EXIT_USAGE
from dgeval.runs.estimates import FILE as ESTIMATES
from dgeval.runs.estimates import estimates_of
from dgeval.runs.files import file_name, write_atomically, write_table
from dgeval.schema import (
    SCHEMA_VERSION,
    TIMINGS,
    TRIALS,
    arrow_table,
)


@dataclass(frozen=True)
class TrialResult:
    """A worker's result for one trial.

    row: of the trial table; None where the trial failed. sha256: of the recording; None where the
    trial failed. resumed: kept from an earlier run. review: sizes of the review recording, bytes.
    traceback: of an internal error. shown: what the trial shows of its hand, for others.
    """

    id: str
    row: dict[str, Any] | None
    exit_code: int
    messages: list[str]
    sha256: str | None
    resumed: bool = False
    review: dict[str, int] | None = None
    traceback: str | None = None
    shown: dict[str, Any] | None = None


def finish_run(out: Path, results: list[TrialResult], config: Config) -> int:
    """Join the tables of the trials, write estimates.json where there are any, log.jsonl and
    run.json; return the run's exit code.
    """
    out.mkdir(parents=True, exist_ok=True)
    done = sorted((r for r in results if r.row is not None), key=lambda r: r.id)
    rows = [r.row for r in done if r.row is not None]
    write_table(out / "trials.parquet", arrow_table(TRIALS, rows))
    timings = [pq.read_table(out / "trials" / f"{file_name(r.id)}.timings.parquet") for r in done]
    write_table(
        out / "timings.parquet", pa.concat_tables(timings) if timings else arrow_table(TIMINGS, [])
    )
    estimates = estimates_of((r.id, r.shown) for r in done if r.shown is not None)
    if estimates is None:
        (out / ESTIMATES).unlink(missing_ok=True)
    else:
        write_atomically(out / ESTIMATES, estimates)
    lines = []
    for r in sorted(results, key=lambda r: r.id):
        lines += [
            json.dumps({"trial": r.id, "exit_code": r.exit_code, "message": m}) for m in r.messages
        ]
        if r.traceback is not None:
            lines.append(
                json.dumps({"trial": r.id, "exit_code": r.exit_code, "traceback": r.traceback})
            )
    write_atomically(out / "log.jsonl", "".join(line + "\n" for line in lines))
    about = {
        "schema_version": SCHEMA_VERSION,
        "dgeval": __version__,
        "config": config.model_dump(mode="json"),
        "fingerprint": fingerprint(),
        "inputs": {r.id: r.sha256 for r in done},
        "failed": {r.id: r.messages for r in results if r.row is None},
    }
    write_atomically(out / "run.json", json.dumps(about, indent=1, sort_keys=True))
    return exit_code_of(results)


def exit_code_of(results: list[TrialResult]) -> int:
    """The exit code of a run from those of its trials.

    4 after an internal error; 2 or the trials' highest code if all failed; 3 if data was lost or
    some trials failed; else 0.
    """
    codes = {r.exit_code for r in results}
    if EXIT_INTERNAL in codes:
        return EXIT_INTERNAL
    if results and all(r.row is None for r in results):
        return EXIT_USAGE if EXIT_USAGE in codes else max(codes)
    return EXIT_DATA_LOST if codes - {EXIT_OK} else EXIT_OK
