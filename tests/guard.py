"""One SHA-256 over everything that a rebuilding must not change: `python -m tests.guard [OPTIONS]`.

It replays the six committed recordings (recorded grasps, FFHNet, VFAS, the csrt tracker), inspects
and reports them, judges 20 modelled failures, and simulates two trials of every scenario. Numbers
and sentences are hashed apart: `values` must stay equal when a message is reworded. Columns and
keys without a value count for nothing, so that an empty column can go.

    python -m tests.guard --write before.json     # on the code to start from
    python -m tests.guard --against before.json   # after each step; names the parts that differ

The hashes hold on one platform only.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import dgeval.worlds  # noqa: F401  # isort: skip  (it chooses how images are drawn before mujoco is imported)
import pandas as pd
from benchmarks.verdict import Job, judge
from dgeval.simulation.campaign import Campaign, run_campaign
from dgeval.simulation.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
SMOKE = ROOT / "datasets" / "ci-smoke" / "ci-smoke.toml"
ARMS: dict[str, tuple[str, ...]] = {
    "recorded": (),
    "ffhnet": ("--set", "grasps.source=ffhnet"),
    "vfas": ("--pipeline", "vfas"),
    "csrt": ("--set", "tracking.method=csrt"),
}
SCENARIOS = (
    "static",
    "conveyor",
    "conveyor-analytic",
    "failures",
    "ci-smoke",
    "handover",
    "table-clearing",
    "turntable",
    "vfas-handover",
)
FAILURES, FAILURES_SEED = 20, 2000  # development trials of the scenario `failures`
VOLATILE = ("key", "seconds", "resumed")  # keys with computing times or the version of dgeval


def canonical(value: Any, texts: list[str]) -> Any:
    """A value in canonical form: floats as hexadecimal, null for empty values.

    Texts with a space (sentences) are moved into `texts`.
    """
    if isinstance(value, dict):
        kept = {str(k): canonical(v, texts) for k, v in sorted(value.items()) if k not in VOLATILE}
        return {k: v for k, v in kept.items() if v is not None}
    if isinstance(value, list | tuple):
        return [canonical(v, texts) for v in value]
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, float):
        return None if math.isnan(value) else float(value + 0.0).hex()
    if isinstance(value, int):
        return value
    if isinstance(value, str) and " " in value:
        texts.append(value)
        return None
    return str(value)


def hashes(value: Any) -> tuple[str, str]:
    """SHA-256 of the numbers and of the sentences of a document."""
    texts: list[str] = []
    values = json.dumps(canonical(value, texts), sort_keys=True)
    return tuple(hashlib.sha256(t.encode()).hexdigest()[:16] for t in (values, json.dumps(texts)))  # type: ignore[return-value]


def of_table(table: pd.DataFrame) -> dict[str, Any]:
    """The columns that are not all null, as lists."""
    table = table[[c for c in table.columns if table[c].notna().any()]]
    return {
        c: table[c].astype(object).where(table[c].notna(), None).tolist() for c in table.columns
    }


def cli(*arguments: object) -> str:
    """Standard output of a command of this checkout's dgeval."""
    command = [sys.executable, "-m", "dgeval", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        raise SystemExit(
            f"dgeval {' '.join(map(str, arguments))}: exit {done.returncode}\n{done.stderr[-2000:]}"
        )
    return done.stdout


def replayed(work: Path, few: bool) -> Iterator[tuple[str, Any]]:
    """Tables, mark rows, models, `inspect --json` and report tables of the committed recordings."""
    manifest = SMOKE
    recordings = sorted(SMOKE.parent.glob("*.mcap"))
    if few:
        recordings = recordings[:2]
        head, *trials = SMOKE.read_text().split("[[trial]]")
        trials = [t for t in trials if any(f'"{r.name}"' in t for r in recordings)]
        manifest = work / "few.toml"
        text = "[[trial]]".join([head, *trials]).replace(
            'recording = "', f'recording = "{SMOKE.parent}/'
        )
        manifest.write_text(text)
    for arm, options in ARMS.items():
        out = work / arm
        cli("replay", manifest, "--out", out, "--no-review", "--jobs", 2, *options)
        for mark in sorted((out / "trials").glob("*.json")):
            name = mark.stem
            yield f"replay/{arm}/{name}/mark", json.loads(mark.read_text())
            for kind in ("frames", "hindsight"):
                path = out / kind / f"{name}.parquet"
                if path.is_file():
                    yield f"replay/{arm}/{name}/{kind}", of_table(pd.read_parquet(path))
            model = out / "models" / f"{name}.ply"
            if model.is_file():
                yield f"replay/{arm}/{name}/model", hashlib.sha256(model.read_bytes()).hexdigest()
        yield f"replay/{arm}/trials", of_table(pd.read_parquet(out / "trials.parquet"))
        timings = pd.read_parquet(out / "timings.parquet").drop(columns="seconds")
        yield f"replay/{arm}/timings", of_table(timings)
    for recording in recordings:
        about = json.loads(cli("inspect", recording, "--json").replace(str(ROOT), ""))
        yield f"inspect/{recording.stem}", about
    for arm in ARMS:
        cli("report", work / arm, "--out", work / f"report-{arm}")
        text = (work / f"report-{arm}" / "report.md").read_text().replace(str(work), "")
        yield f"report/{arm}/numbers", re.findall(r"[-+]?\d+(?:\.\d+)?", text)
        yield f"report/{arm}/text", [line + " " for line in text.splitlines()]
        text = (work / f"report-{arm}" / "trials.csv").read_text().replace(str(work), "")
        csv = pd.read_csv(io.StringIO(text))
        yield f"report/{arm}/csv", of_table(csv)


def judged(work: Path, few: bool) -> Iterator[tuple[str, Any]]:
    """Second pass and verdict of modelled failures by twin and by geometry, with the truth."""
    n_wanted = 3 if few else FAILURES
    with ProcessPoolExecutor(2) as pool:
        first = 0
        n_found = 0
        while n_found < n_wanted:
            jobs = [
                Job(
                    "failures",
                    FAILURES_SEED,
                    k,
                    "as simulated",
                    3,
                    ("twin", "geometry"),
                    False,
                    False,
                    False,
                )
                for k in range(first, first + n_wanted)
            ]
            for row in pool.map(judge, jobs):
                if "twin" in row and n_found < n_wanted:
                    n_found += 1
                    yield f"judge/{row['index']}", row
            first += n_wanted


def simulated(work: Path, few: bool) -> Iterator[tuple[str, Any]]:
    """Truth and recordings of trials of every scenario."""
    for name in SCENARIOS[:3] if few else SCENARIOS:
        scenario = load_scenario(name).model_copy(update={"choose": None})
        campaign = Campaign(scenario, 5, 1 if few else 2, work / f"simulated-{name}")
        for truth, recording in run_campaign(campaign, 2, lambda *_: None):
            yield f"simulate/{name}/{truth['id']}/truth", truth
            yield f"simulate/{name}/{truth['id']}/recording", recording


PARTS: dict[str, Callable[[Path, bool], Iterator[tuple[str, Any]]]] = {
    "replay": replayed,
    "judge": judged,
    "simulate": simulated,
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", choices=list(PARTS), help="a part of it")
    parser.add_argument(
        "--few",
        action="store_true",
        help="a fast look: two recordings, three failures, three trials",
    )
    parser.add_argument("--write", type=Path, help="JSON with the hashes of all parts")
    parser.add_argument(
        "--against", type=Path, help="JSON of an earlier run; exit 1 where the values differ"
    )
    options = parser.parse_args()
    parts: dict[str, tuple[str, str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for part in options.only or PARTS:
            for name, value in PARTS[part](Path(folder), options.few):
                parts[name] = hashes(value)
                print(f"{parts[name][0]} {parts[name][1]} {name}", flush=True)
    values, texts = (
        hashlib.sha256(json.dumps([(n, parts[n][i]) for n in sorted(parts)]).encode()).hexdigest()
        for i in (0, 1)
    )
    print(f"values {values}\ntexts  {texts}")
    if options.write is not None:
        options.write.write_text(json.dumps(parts, indent=1, sort_keys=True) + "\n")
    if options.against is None:
        return
    before = json.loads(options.against.read_text())
    relevant = {n: b for n, b in before.items() if n in parts or not (options.only or options.few)}
    differs = [
        n
        for n in sorted({*relevant, *parts})
        if n not in parts or n not in relevant or parts[n][0] != relevant[n][0]
    ]
    reworded = [n for n in sorted(parts) if n in relevant and parts[n][1] != relevant[n][1]]
    print(f"{len(parts)} parts; values differ in {len(differs)}, sentences in {len(reworded)}")
    for kind, names in (("values", differs), ("sentences", reworded)):
        for name in names:
            print(f"  {kind}: {name}")
    raise SystemExit(1 if differs else 0)


if __name__ == "__main__":
    main()
