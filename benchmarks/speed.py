"""Frames per second, time per stage and memory of `dgeval replay`, with bare decoding as the floor.

Each command runs in a process of its own, so that its time includes the start, and its memory is
the peak of the process. The long recording is the synthetic one played forward and backward 20
times; it shows whether memory grows with length.

    python -m benchmarks.speed
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from dgeval.config import Config
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.recording.trials import open_trial

from benchmarks import result, synthetic
from benchmarks.motion import Motion
from benchmarks.rebase import rebase

DEMO = Path(__file__).parent.parent / "datasets" / "demo.mcap"
KITCHEN, KITCHEN_BOX = "kitchen_mug_mcap", "430,342,524,432"
MIB = 1024.0  # ru_maxrss is in KiB on Linux


@dataclass(frozen=True)
class Run:
    """One process: wall time s, peak resident memory MiB, exit code, last printed line."""

    seconds: float
    peak_mib: float
    code: int
    last_line: str


# A small process starts the measured one: a child's peak memory includes its parent's before exec.
LAUNCH = """
import os, subprocess, sys, time
before = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
lines = process.stdout.read().decode().strip().splitlines()
_, status, usage = os.wait4(process.pid, 0)
process.returncode = 0
print(time.perf_counter() - before, usage.ru_maxrss, os.waitstatus_to_exitcode(status), *lines[-1:])
"""


def run(arguments: list[str]) -> Run:
    """Run this Python with arguments."""
    command = [sys.executable, "-c", LAUNCH, sys.executable, *arguments]
    fields = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split(
        maxsplit=3
    )
    scale = MIB if sys.platform != "darwin" else MIB * 1024
    return Run(
        float(fields[0]),
        float(fields[1]) / scale,
        int(fields[2]),
        fields[3].strip() if len(fields) > 3 else "",
    )


def decode(path: Path) -> tuple[int, float]:
    """Decode every frame of a recording's first trial: (number of frames, seconds)."""
    trial = open_trial(find_trials([path])[0], Config())
    before = time.perf_counter()
    return sum(1 for _ in trial.frames()), time.perf_counter() - before


@dataclass(frozen=True)
class Recording:
    name: str
    path: Path
    box: str | None
    review: bool = True


def measured(recording: Recording, folder: Path) -> tuple[list[list[str]], list[str]]:
    """Rows of frames, wall time, rate and memory per command; and the stages' row of the last."""
    n = result.number
    floor = run(["-m", "benchmarks.speed", "--decode", str(recording.path)])
    out = folder / "run"
    base = ["-m", "dgeval", "replay", str(recording.path), "--out", str(out), "--force"]
    base += ["--bbox", recording.box] if recording.box else []
    commands = {"replay --no-review": [*base, "--no-review"]}
    if recording.review:
        commands["replay --review"] = [*base, "--review"]
    rows: list[list[str]] = []
    decoded, decode_s = floor.last_line.split()
    rows.append(
        [
            recording.name,
            "scan and decode",
            decoded,
            n(floor.seconds),
            "–",
            n(int(decoded) / float(decode_s)),
            _mib(floor),
        ]
    )
    per_frame = np.zeros(0)
    for name, arguments in commands.items():
        process = run(arguments)
        if process.code not in (0, 3):
            raise SystemExit(f"{recording.name}, {name}: exit code {process.code}")
        timings = pd.read_parquet(out / "timings.parquet")
        per_frame = timings.groupby(["trial", "frame"])["seconds"].sum().to_numpy()
        rate, stage_rate = len(per_frame) / process.seconds, len(per_frame) / per_frame.sum()
        rows.append(
            [
                recording.name,
                name,
                str(len(per_frame)),
                n(process.seconds),
                n(rate),
                n(stage_rate),
                _mib(process),
            ]
        )
    ms = timings.assign(ms=timings["seconds"] * 1e3).groupby("stage", sort=False)["ms"]
    stages = [f"{g.median():.1f} / {g.quantile(0.95):.1f}" for _, g in ms]
    total = per_frame * 1e3
    return rows, [
        recording.name,
        *stages,
        f"{np.median(total):.1f} / {np.quantile(total, 0.95):.1f}",
    ]


def _mib(process: Run) -> str:
    return result.number(process.peak_mib, 0)


def recordings(folder: Path, frames: int, times: int) -> list[Recording]:
    """The demo, a synthetic 640x480 recording, the real one if available, and the long one."""
    out = [Recording("demo 320x240", DEMO, None)] if DEMO.exists() else []
    short, long = folder / "made.mcap", folder / "made_long.mcap"
    truth = synthetic.write(short, frames)
    box = ",".join(f"{v:.0f}" for v in truth.boxes[0])
    rebase(open_trial(TrialSpec("made", short), Config()), long, Motion("still"), times)
    out.append(Recording("made 640x480", short, box))
    data = os.environ.get("DGEVAL_REAL_DATA")
    if data and (Path(data) / KITCHEN).exists():
        out.append(Recording("kitchen mug 640x480 (real)", Path(data) / KITCHEN, KITCHEN_BOX))
    out.append(Recording(f"made 640x480, {times} times as long", long, box, review=False))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=99, help="of the made recording")
    parser.add_argument("--times", type=int, default=20, help="length of the long recording")
    parser.add_argument(
        "--decode", type=Path, help="only decode this recording (used by the benchmark itself)"
    )
    parser.add_argument("--name", default="speed", help="name of the result file")
    args = parser.parse_args()
    if args.decode is not None:
        print(*decode(args.decode))
        return
    before = os.getloadavg()[0]
    start = run(["-m", "dgeval", "--help"])
    rows: list[list[str]] = [
        ["–", "dgeval --help", "–", result.number(start.seconds), "–", "–", _mib(start)]
    ]
    stage_rows: list[list[str]] = []
    with tempfile.TemporaryDirectory() as name:
        for recording in recordings(Path(name), args.frames, args.times):
            print(recording.name, file=sys.stderr)
            with tempfile.TemporaryDirectory(dir=name) as inner:
                new_rows, stages = measured(recording, Path(inner))
                names = list(
                    pd.read_parquet(Path(inner) / "run" / "timings.parquet")["stage"].unique()
                )
            rows += new_rows
            stage_rows.append(stages)
    load = f"{before:.1f} before, {os.getloadavg()[0]:.1f} after, of which this is 1"
    head = (
        "recording",
        "what",
        "frames",
        "wall, s",
        "frames/s",
        "frames/s in the stages",
        "peak memory, MiB",
    )
    parts = [
        '## Rate and memory\n\nWall time of a process of its own, start included. "In the '
        'stages": the frames by the sum of '
        "the stages' times (the decoding itself in the first rows), without start, scan, tables "
        "and review. Load of "
        f"the machine while measuring (1-minute average of {os.cpu_count()} cores): {load}.\n\n"
        + result.table(head, rows),
        "## Time per stage\n\nms, median / p95, from timings.parquet.\n\n"
        + result.table(["recording", *names, "all"], stage_rows),
    ]
    path = result.write(args.name, "Speed and memory", "python -m benchmarks.speed", parts)
    print(path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
