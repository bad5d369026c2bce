"""Catches: a change that the gate misses, a false alarm, a wrong stage or frame in the message.

Also a baseline that is accepted for another data set, schema or recording.
"""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from benchmarks.gate import false_alarms
from dgeval.compare.closed_loop import compare_campaigns
from dgeval.compare.comparison import compare_runs
from dgeval.compare.divergence import difference
from dgeval.compare.output import as_html, as_json, as_markdown
from dgeval.compare.paired import (
    METRICS,
    answers,
    holm,
    mcnemar,
    signed_rank,
    trials_needed,
    walsh_interval,
)
from dgeval.config import load_config
from dgeval.errors import UsageError
from dgeval.recording.manifest import find_trials
from dgeval.runs.folder import finish_run
from dgeval.runs.results import Run, read_run
from dgeval.runs.trial_job import replay_trial
from dgeval.schema import STAGES
from junitparser import JUnitXml, Skipped
from scipy.stats import wilcoxon

ROOT = Path(__file__).resolve().parents[2]
SMOKE = ROOT / "datasets" / "ci-smoke"
NAME = "pudding_box-120-0030"
# what is compared here are the stages; the twin would cost more than all of them
QUICK = "verdict.method=geometry"
Dgeval = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Manifest of the first 30 frames of one committed trial; nothing is grasped in them."""
    folder = tmp_path_factory.mktemp("short")
    trial = next(
        t for t in tomllib.loads((SMOKE / "ci-smoke.toml").read_text())["trial"] if t["id"] == NAME
    )
    shutil.copy(SMOKE / f"{NAME}.mcap", folder / "a.mcap")
    text = (
        'name = "short"\n[[trial]]\nid = "a"\nrecording = "a.mcap"\nframes = [0, 30]\n'
        f"bbox = {trial['bbox']}\n"
    )
    (folder / "short.toml").write_text(text)
    return folder / "short.toml"


def run_of(manifest: Path, out: Path, *assignments: str) -> Run:
    config = load_config("dynamic", (QUICK, *assignments))
    finish_run(
        out, [replay_trial(s, config, out, None, True) for s in find_trials([manifest])], config
    )
    return read_run(out)


@pytest.fixture(scope="module")
def before(manifest: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of(manifest, tmp_path_factory.mktemp("before"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("assignment", "stage", "first"),
    [
        ("clock.colour.offset_ns=1000", "input", 0),
        ("tracking.method=csrt", "tracking", None),
        ("registration.search_radius=0.006", "registration", 1),
        ("fusion.epsilon=0.002", "fusion", None),
        ("estimation.sigma_position=0.008", "estimation", None),
        ("schedule.grasps_latency_s=0.1", "grasps", None),
        ("servo.c_p_v=1.3", "servo", None),
        ("execution.c_e=1e-30", "execution", None),
    ],
)
def test_a_parameter_is_caught_at_its_stage(
    manifest: Path, before: Run, tmp_path: Path, assignment: str, stage: str, first: int | None
) -> None:
    after = run_of(manifest, tmp_path, assignment)
    c = compare_runs(before, after)
    assert c.first is not None
    assert c.first.first.stage == stage
    assert [field for field, _, _ in c.config] == [assignment.split("=")[0]]
    # the frame named is the first that differs, in a column of that stage
    old, new = before.frames("a"), after.frames("a")
    field = c.first.first.field
    unequal = ~((old[field] == new[field]) | (old[field].isna() & new[field].isna()))
    assert int(np.flatnonzero(unequal)[0]) == c.first.first.frame
    if first is not None:
        assert c.first.first.frame == first
    for earlier in STAGES[: STAGES.index(stage)]:
        if first == 0 or earlier == "input":
            assert earlier not in c.first.stages


def edited(run: Run, out: Path, change: Callable[[pd.DataFrame], None]) -> Run:
    """A copy of a run with its frames changed, and with other digests."""
    shutil.copytree(run.folder, out)
    path = out / "frames" / "a.parquet"
    frames = pd.read_parquet(path)
    change(frames)
    frames.to_parquet(path)
    trials = pd.read_parquet(out / "trials.parquet")
    trials[[f"digest_{s}" for s in STAGES]] = "other"
    trials.to_parquet(out / "trials.parquet")
    return read_run(out)


@pytest.mark.slow
def test_equal_digests_need_no_frames(before: Run, tmp_path: Path) -> None:
    shutil.copytree(before.folder, tmp_path / "b")
    (tmp_path / "b" / "frames" / "a.parquet").unlink()
    assert compare_runs(before, read_run(tmp_path / "b")).conclusion == "identical"


@pytest.mark.slow
def test_a_run_from_before_a_fact_was_added_is_compared(before: Run, tmp_path: Path) -> None:
    """Catches a baseline of an older version that ends the gate in an internal error."""
    shutil.copytree(before.folder, tmp_path / "b")
    table = tmp_path / "b" / "trials.parquet"
    pd.read_parquet(table).drop(columns="observed_class").to_parquet(table)
    older = read_run(tmp_path / "b")
    assert compare_runs(older, before).conclusion == "identical"
    assert compare_runs(before, older).conclusion == "identical"


@pytest.mark.slow
def test_last_bits_are_within_tolerance_and_more_is_not(before: Run, tmp_path: Path) -> None:
    def slightly(frames: pd.DataFrame) -> None:
        frames["feature_px"] += 1e-9

    def clearly(frames: pd.DataFrame) -> None:
        frames.loc[7, "feature_px"] += 1e-4

    def gone(frames: pd.DataFrame) -> None:
        frames.loc[9, "velocity_y"] = np.nan

    assert (
        compare_runs(before, edited(before, tmp_path / "a", slightly)).conclusion
        == "within tolerance"
    )
    for k, (change, frame, field) in enumerate(
        ((clearly, 7, "feature_px"), (gone, 9, "velocity_y"))
    ):
        c = compare_runs(before, edited(before, tmp_path / f"b{k}", change))
        assert c.first is not None
        assert (c.first.first.frame, c.first.first.field) == (frame, field)
        assert not c.first.within
        assert "NaN" not in json.dumps(as_json(c))
        assert field in as_markdown(c)
        assert "data:image/png" in as_html(c)


@pytest.mark.slow
def test_grasps_by_ffhnet_in_place_of_the_recorded_ones(
    manifest: Path, before: Run, tmp_path: Path
) -> None:
    """Catches FFHNet grasps that the notes don't name, that lie far from the target, or that vary.

    Every frame with a model has one, and the comparison with recorded grasps differs first at
    `grasps`.
    """
    once, again = (
        run_of(manifest, tmp_path / name, "grasps.source=ffhnet", "grasps.candidates=64")
        for name in "ab"
    )
    assert not compare_runs(once, again).differences
    assert "FFHNet with dgeval's own weights" in once.trials["notes"].iloc[0]
    frames = once.frames("a")
    chosen = frames[frames["grasp_px"].notna()]
    assert len(chosen) > 20
    assert chosen["n_grasps"].isin([64, 65]).all()  # the one chosen before stays among them
    assert chosen["grasp_score"].between(0, 1).all()
    assert chosen["hand_score"].between(0, 1).all()
    near = (
        chosen[["grasp_px", "grasp_py", "grasp_pz"]].to_numpy()
        - chosen[["feature_px", "feature_py", "feature_pz"]].to_numpy()
    )
    assert np.nanmax(np.linalg.norm(near.astype(float), axis=1)) < 0.35
    first = compare_runs(before, once).first
    assert first is not None
    assert first.first.stage == "grasps"


@pytest.mark.slow
def test_a_run_that_is_shorter_differs(before: Run) -> None:
    frames = before.frames("a")
    shorter = difference("a", frames, frames.iloc[:20])
    assert shorter is not None
    assert (shorter.first.frame, shorter.first.field, shorter.n_frames) == (
        20,
        "n_frames",
        (30, 20),
    )


@pytest.mark.slow
def test_the_gate_from_the_command_line(manifest: Path, dgeval: Dgeval, tmp_path: Path) -> None:
    baseline, out = tmp_path / "short.zip", tmp_path / "out"

    def gate(*more: object, cwd: Path = tmp_path) -> subprocess.CompletedProcess[str]:
        command = ("regress", manifest, "--baseline", baseline, "--out", out, "--set", QUICK)
        return dgeval(*command, *more, cwd=cwd)

    assert gate().returncode == 2  # none yet
    assert gate("--update").returncode == 2  # no reason
    dirty = tmp_path / "dirty"
    dirty.mkdir()
    subprocess.run(["git", "init", "-q", str(dirty)], check=True)
    (dirty / "new.py").touch()
    refused = gate("--update", "--reason", "first", cwd=dirty)
    assert refused.returncode == 2
    assert "uncommitted" in refused.stderr
    assert gate("--update", "--reason", "first").returncode == 1  # writing one never passes
    assert json.loads(zipfile.ZipFile(baseline).read("baseline.json"))["reason"] == "first"

    assert (done := gate()).returncode == 0, done.stderr
    assert "identical" in done.stdout

    # results of an earlier run in the folder are not used for this one
    mark = out / "trials" / "a.json"
    mark.write_text(mark.read_text().replace('"digest_tracking": "', '"digest_tracking": "0'))
    assert "identical" in gate().stdout

    # a change of the configuration is named field by field, and the runs are compared all the same
    done = gate("--set", "estimation.sigma_position=0.012", "--json")
    document = json.loads(done.stdout)
    assert document["config"] == [
        {"field": "estimation.sigma_position", "old": 0.004, "new": 0.012}
    ]
    assert "estimation.sigma_position: 0.004 -> 0.012" in done.stderr
    assert document["first_divergence"]["stage"] == "estimation"
    assert document["conclusion"] == "inconclusive"  # one trial tells nothing
    assert done.returncode == 0
    assert "warning" in done.stderr
    assert (out / "changed" / "a.rrd").stat().st_size > 1000
    strict = gate("--set", "estimation.sigma_position=0.012", "--fail-on", "inconclusive")
    assert strict.returncode == 1
    suites = {s.name: s for s in JUnitXml.fromfile(str(out / "junit.xml"))}
    assert {name: (s.tests, s.failures, s.errors) for name, s in suites.items()} == {
        "trials": (1, 0, 0),
        "metrics": (len(METRICS), 0, 0),
        "gate": (1, 1, 0),
    }
    cases = {(name, c.name): c for name, s in suites.items() for c in s}
    assert "estimation" in cases["trials", "a"].system_out
    assert isinstance(cases["metrics", "velocity_error"].result[0], Skipped) == (
        suites["metrics"].skipped > 0
    )
    assert "can't tell" in cases["gate", "gate"].result[0].message

    # the verdict changes while every stage gives the same bytes: no metric measures that
    changed_verdict = tmp_path / "told.zip"
    with zipfile.ZipFile(baseline) as read, zipfile.ZipFile(changed_verdict, "w") as write:
        for member in read.namelist():
            data = read.read(member)
            if member == "trials.parquet":
                table = pd.read_parquet(io.BytesIO(data)).assign(failure_class="collision")
                table.to_parquet(changed := io.BytesIO())
                data = changed.getvalue()
            write.writestr(member, data)
    done = gate("--baseline", changed_verdict)
    assert done.returncode == 0
    assert "disagreement" in done.stderr
    assert "failure_class collision -> " in done.stdout
    case = next(c for s in JUnitXml.fromfile(str(out / "junit.xml")) for c in s if c.name == "a")
    assert "failure_class" in case.result[0].message

    # a baseline of another data set, another recording, another schema
    shutil.copy(manifest, manifest.with_name("other.toml"))
    done = dgeval("regress", manifest.with_name("other.toml"), "--baseline", baseline, "--out", out)
    assert done.returncode == 2
    assert "'short'" in done.stderr
    moved = tmp_path / "moved"
    moved.mkdir()
    (moved / "short.toml").write_text(manifest.read_text())
    shutil.copy(SMOKE / "foam_brick-040-0004.mcap", moved / "a.mcap")
    done = dgeval("regress", moved / "short.toml", "--baseline", baseline, "--out", out)
    assert done.returncode == 3
    assert "recording of trial a" in done.stderr
    old = tmp_path / "old.zip"
    with zipfile.ZipFile(baseline) as read, zipfile.ZipFile(old, "w") as write:
        about = json.loads(read.read("baseline.json"))
        write.writestr("baseline.json", json.dumps({**about, "schema_version": 0}))
    done = dgeval("regress", manifest, "--baseline", old, "--out", out)
    assert done.returncode == 2
    assert "schema 0" in done.stderr


# statistics


def test_holm_is_the_textbook() -> None:
    """p values worked out by hand: n p, (n - 1) p, ... in rising order, never falling."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_mcnemar_is_exact() -> None:
    """p = 2 * sum of binomial(n, 1/2) up to the smaller count, worked out by hand."""
    for lost, gained, p in ((5, 0, 0.0625), (6, 0, 0.03125), (8, 1, 0.0390625), (10, 2, 0.0385742)):
        old = [True] * lost + [False] * gained + [True] * 30
        new = [False] * lost + [True] * gained + [True] * 30
        assert mcnemar(old, new) == (lost, gained, pytest.approx(p, abs=1e-6))


def test_signed_rank_with_equal_sizes_is_exact() -> None:
    # ranks 1.5, 1.5, 3, 4: only the two sets of equal signs have a rank sum as extreme as 0 or 10
    assert signed_rank(np.array([1.0, 1.0, 2.0, 3.0, 0.0])) == 2 / 16
    rng = np.random.default_rng(3)
    for n in (6, 13):
        d = rng.normal(0.4, 1, n)
        assert signed_rank(d) == pytest.approx(wilcoxon(d, method="exact").pvalue, abs=1e-12)
    assert signed_rank(np.zeros(5)) == 1.0


def test_walsh_interval_agrees_with_the_test_it_belongs_to() -> None:
    rng = np.random.default_rng(0)
    for n in (12, 40):
        d = rng.normal(0.3, 1, n)
        low, high = walsh_interval(d, 0.05)
        assert wilcoxon(d - (low - 1e-6)).pvalue < 0.055
        assert wilcoxon(d - (high + 1e-6)).pvalue < 0.055
        assert wilcoxon(d - (low + high) / 2).pvalue > 0.5
    assert walsh_interval(d[:5], 0.05) == (-np.inf, np.inf)


def shifted(n: int, shift: float, noise: float, metric: str) -> list[str]:
    """The answer for one metric that got worse by `shift`, under noise in all metrics.

    shift, noise (standard deviation): in relevant differences.
    """
    rng = np.random.default_rng(1)
    old = {m.name: rng.normal(0.5, 0.1, n) for m in METRICS}
    new = {m.name: old[m.name] + rng.normal(0, noise * m.relevant, n) for m in METRICS}
    relevant = next(m.relevant for m in METRICS if m.name == metric)
    new[metric] += shift * relevant
    return [r.answer for r in answers(old, new) if r.metric.name == metric]


def test_three_answers() -> None:
    """Catches a swapped sign, a metric with the wrong direction, a verdict on too few trials."""
    assert shifted(40, 3.0, 1.0, "velocity_error") == ["worse"]
    assert shifted(40, -3.0, 1.0, "velocity_error") == ["better"]
    assert shifted(40, -3.0, 1.0, "gate_fitness") == ["worse"]  # there more is better
    assert shifted(40, 0.0, 1.0, "velocity_error") == ["same"]
    assert shifted(6, 1.0, 3.0, "velocity_error") == ["inconclusive"]
    assert shifted(1, 50.0, 0.1, "velocity_error") == ["inconclusive"]  # one trial proves nothing


def test_planned_number_of_trials_finds_what_matters() -> None:
    rng = np.random.default_rng(2)
    metric = METRICS[3]
    n = trials_needed(3 * metric.relevant, metric.relevant, 0.05, 6)
    assert n is not None
    times_found = 0
    for _ in range(60):
        old = {m.name: rng.normal(0.5, 0.1, n) for m in METRICS}
        new = {m.name: old[m.name] + rng.normal(0, 3 * m.relevant, n) for m in METRICS}
        new[metric.name] += metric.relevant * 1.3
        times_found += next(r.answer for r in answers(old, new) if r.metric is metric) == "worse"
    assert times_found >= 40  # planned for 80 % at the border of what matters


def test_gate_gives_no_more_false_alarms_than_it_states() -> None:
    wrong, n = false_alarms(150, 30, 0)
    assert n == 150
    assert wrong <= 0.05 * n + 2 * np.sqrt(0.05 * 0.95 * n)


def test_campaigns_are_compared_on_equal_seeds_only(tmp_path: Path) -> None:
    for name, seed, ended in (("a", 0, "success"), ("b", 0, "failure"), ("c", 1, "success")):
        rows = [
            {"id": f"t{k}", "verdict": {"outcome": ended if k < 7 else "success", "seed": seed}}
            for k in range(20)
        ]
        (tmp_path / name).mkdir()
        (tmp_path / name / "simulated.json").write_text(json.dumps({"simulated": rows}))
    result = compare_campaigns(tmp_path / "a", tmp_path / "b")
    assert (result["lost"], result["gained"], result["answer"]) == (7, 0, "worse")
    with pytest.raises(UsageError, match="not pairs"):
        compare_campaigns(tmp_path / "a", tmp_path / "c")
