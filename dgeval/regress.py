"""The regression gate: may a change of code merge? A data set is replayed and compared.

A baseline is one zip file. It holds the tables of a run, and `baseline.json` with the data set, the
recordings' hashes, the version and the reason for which it was made.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from dgeval.compare.comparison import Comparison, compare_runs
from dgeval.compare.paired import METRICS
from dgeval.errors import OtherRecordingsError, Place, UsageError
from dgeval.recording.manifest import TrialSpec
from dgeval.runs.files import file_name
from dgeval.runs.results import Run, read_run
from dgeval.schema import SCHEMA_VERSION

EPOCH = (1980, 1, 1, 0, 0, 0)  # date of every zip member, so that equal tables give equal bytes
UNDECIDED = ("inconclusive", "disagreement")  # conclusions that pass with a warning
TABLES = ("run.json", "trials.parquet", "timings.parquet")


def dataset_of(specs: Iterable[TrialSpec], inputs: dict[str, str]) -> dict[str, Any]:
    """Identity of a data set: the manifest's entries and the recordings' SHA-256, by trial.

    inputs: SHA-256 by trial. Path and name of a recording are no part of the identity. The result's
    `sha256` is over all of it.
    """
    outside = ("recording", "sha256", "parts", "window_is_log_time", "is_between_pauses")
    trials = {
        s.id: _without_none({k: v for k, v in asdict(s).items() if k not in outside}) for s in specs
    }
    about = {
        "trials": json.loads(json.dumps(trials, default=str)),
        "inputs": dict(sorted(inputs.items())),
    }
    return {
        **about,
        "sha256": hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest(),
    }


def _without_none(entry: dict[str, Any]) -> dict[str, Any]:
    """A manifest's entry without what it does not say, so that a new field changes no old entry."""
    return {k: v for k, v in entry.items() if v is not None}


def write_baseline(
    path: Path, folder: Path, dataset: str, specs: list[TrialSpec], reason: str
) -> None:
    """Store a finished run as the baseline of a data set.

    Equal tables give equal bytes, except for the measured times in them.
    """
    run = read_run(folder)
    about = {
        "dataset": dataset,
        "schema_version": SCHEMA_VERSION,
        "reason": reason,
        "made_with": run.about["dgeval"],
        **dataset_of(specs, run.about["inputs"]),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    names = [*TABLES]
    for trial in run.trials["trial"]:
        names += [f"{kind}/{file_name(trial)}.parquet" for kind in ("frames", "hindsight")]
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(
            zipfile.ZipInfo("baseline.json", EPOCH), json.dumps(about, indent=1, sort_keys=True)
        )
        for name in names:
            if (folder / name).is_file():
                file.writestr(
                    zipfile.ZipInfo(name, EPOCH), (folder / name).read_bytes(), zipfile.ZIP_DEFLATED
                )
    part.replace(path)


def read_baseline(path: Path, into: Path) -> tuple[dict[str, Any], Run]:
    """Unpack a baseline into the folder `into`: its baseline.json and its run.

    UsageError where the file is no baseline, or its tables have another schema version.
    """
    try:
        with zipfile.ZipFile(path) as file:
            about: dict[str, Any] = json.loads(file.read("baseline.json"))
            if about["schema_version"] != SCHEMA_VERSION:
                what = (
                    f"the baseline has tables of schema {about['schema_version']}, this dgeval "
                    f"writes {SCHEMA_VERSION}"
                )
                raise UsageError(what, Place(str(path)), "make it again with --update --reason")
            file.extractall(into)
    except FileNotFoundError as error:
        hint = "write it with --update --reason 'first baseline'"
        raise UsageError("there is no baseline", Place(str(path)), hint) from error
    except (OSError, zipfile.BadZipFile, ValueError, KeyError) as error:
        raise UsageError(
            f"not a baseline ({type(error).__name__}: {error})", Place(str(path))
        ) from error
    return about, read_run(into)


def check_dataset(about: dict[str, Any], dataset: str, specs: list[TrialSpec], path: Path) -> None:
    """UsageError where the baseline is of another data set, by its name or by its trials."""
    if about["dataset"] != dataset:
        raise UsageError(
            f"the baseline is of data set {about['dataset']!r}, this is {dataset!r}",
            Place(str(path)),
        )
    now = dataset_of(specs, {})["trials"]
    before = {trial: _without_none(entry) for trial, entry in about["trials"].items()}
    for trial in sorted(set(now) | set(before)):
        if now.get(trial) == before.get(trial):
            continue
        if trial not in now or trial not in before:
            where = "the baseline" if trial not in now else "the data set"
            raise UsageError(
                f"trial {trial} is only in {where}",
                Place(str(path)),
                "make the baseline again with --update",
            )
        keys = sorted(now[trial].keys() | before[trial].keys())
        fields = [k for k in keys if now[trial].get(k) != before[trial].get(k)]
        what = f"trial {trial}: {', '.join(fields)} of the manifest changed since the baseline"
        raise UsageError(what, Place(str(path)), "make the baseline again with --update")


def check_recordings(about: dict[str, Any], inputs: dict[str, str], path: Path) -> None:
    """OtherRecordingsError where a recording is not the one that the baseline was made from."""
    other = [t for t in sorted(inputs) if about["inputs"].get(t) != inputs[t]]
    if other:
        more = f" and {len(other) - 1} more" if len(other) > 1 else ""
        what = (
            f"the recording of trial {other[0]}{more} is not the one that the baseline was made "
            "from"
        )
        raise OtherRecordingsError(what, Place(str(path)), "give those, or make the baseline again")


def gate(baseline: Run, now: Run, fail_on_inconclusive: bool) -> tuple[Comparison, bool, str]:
    """The comparison, whether the change may pass, and the reason as a sentence.

    A change fails where a metric is worse or a trial is missing. It also fails where the conclusion
    is in UNDECIDED, if `fail_on_inconclusive`.
    """
    comparison = compare_runs(baseline, now)
    missing = list(comparison.only_old)
    if missing:
        return (
            comparison,
            False,
            f"{len(missing)} trials of the baseline were not replayed, {missing[0]} first",
        )
    message = {
        "identical": "every stage of every trial gives the baseline's bytes",
        "within tolerance": "differences are within the tolerances of their fields",
        "same": "results changed, by less than matters",
        "better": "results changed for the better",
        "inconclusive": "results changed, and these trials can't tell whether for the worse",
        "disagreement": "facts of the log are told differently, and one of the two is wrong: "
        + "; ".join(f"{t}: {f} {a} -> {b}" for t, f, a, b in comparison.facts[:3])
        + (f"; and {len(comparison.facts) - 3} more" if len(comparison.facts) > 3 else ""),
        "worse": "results changed for the worse: "
        + ", ".join(r.metric.name for r in comparison.results if r.answer == "worse"),
    }[comparison.conclusion]
    passed = comparison.conclusion != "worse" and not (
        fail_on_inconclusive and comparison.conclusion in UNDECIDED
    )
    if comparison.first is not None:
        message += f". First divergence: {comparison.first.first}"
    return comparison, passed, message


def junit(comparison: Comparison, passed: bool, message: str, dataset: str) -> str:
    """The comparison as JUnit XML: a case per trial, per metric, and one for the gate.

    A trial with changed facts of the log, and an inconclusive metric, count as skipped.
    message: the gate's sentence, given where it failed.
    """
    suites = ElementTree.Element("testsuites", name=f"dgeval regress {dataset}")
    differing = {d.trial: d for d in comparison.differences}
    trials = _suite(suites, "trials", len(comparison.trials) + len(comparison.only_old))
    for trial in comparison.trials:
        case = ElementTree.SubElement(trials, "testcase", classname=f"{dataset}.trials", name=trial)
        if changed_facts := "; ".join(
            f"{f} {a} -> {b}" for t, f, a, b in comparison.facts if t == trial
        ):
            ElementTree.SubElement(
                case, "skipped", message=f"one of the two is wrong: {changed_facts}"
            )
        if (d := differing.get(trial)) is not None and not d.within:
            out = ElementTree.SubElement(case, "system-out")
            out.text = f"changed: {d.first}; frames that differ by stage: {d.stages}"
    for trial in comparison.only_old:
        case = ElementTree.SubElement(trials, "testcase", classname=f"{dataset}.trials", name=trial)
        ElementTree.SubElement(case, "failure", message="not replayed")
    metrics = _suite(suites, "metrics", len(METRICS))
    results = {r.metric: r for r in comparison.results}
    for metric in METRICS:
        case = ElementTree.SubElement(
            metrics, "testcase", classname=f"{dataset}.metrics", name=metric.name
        )
        if (r := results.get(metric)) is None:
            continue  # same bytes, or nothing to measure it by
        about = f"{r.old:.6g} -> {r.new:.6g}, p {r.p:.3f}, {r.n} trials"
        if r.answer == "worse":
            ElementTree.SubElement(case, "failure", message=f"worse: {about}")
        elif r.answer == "inconclusive":
            ElementTree.SubElement(
                case,
                "skipped",
                message=f"inconclusive: {about}; some {r.needed} trials would settle it",
            )
    whole = _suite(suites, "gate", 1)
    case = ElementTree.SubElement(whole, "testcase", classname=dataset, name="gate")
    if not passed:
        ElementTree.SubElement(case, "failure", message=message)
    for suite in suites:
        for kind, tag in (("failures", "failure"), ("skipped", "skipped")):
            suite.set(kind, str(len(suite.findall(f"testcase/{tag}"))))
    ElementTree.indent(suites)
    return ElementTree.tostring(suites, encoding="unicode", xml_declaration=True)


def _suite(parent: ElementTree.Element, name: str, tests: int) -> ElementTree.Element:
    return ElementTree.SubElement(parent, "testsuite", name=name, tests=str(tests), errors="0")
