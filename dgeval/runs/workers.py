"""Trials in parallel on local processes, one thread each.

Results don't depend on the number of processes.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from dgeval.config import Config
from dgeval.determinism import set_thread_variables
from dgeval.errors import EXIT_INTERNAL
from dgeval.recording.manifest import TrialSpec
from dgeval.runs.folder import TrialResult
from dgeval.runs.trial_job import ReviewFactory, replay_trial
from dgeval.verdict.estimates import Estimates


def replay_trials(
    specs: list[TrialSpec],
    config: Config,
    out: Path,
    review: ReviewFactory | None,
    force: bool,
    jobs: int,
    on_result: Callable[[TrialResult], None],
    progress: Callable[[int, int], None] | None = None,
    hashes: Mapping[str, str] | None = None,
    estimates: Estimates | None = None,
) -> list[TrialResult]:
    """Replay every trial; results in the order of `specs`. With one job it happens in this process.

    hashes: SHA-256 of the recording by trial, where the caller computed them already. estimates:
    what trials of another run show of the hands.
    """
    known = hashes or {}
    results: dict[str, TrialResult] = {}
    if jobs == 1 or len(specs) == 1:
        for spec in specs:
            results[spec.id] = replay_trial(
                spec, config, out, review, force, progress, known.get(spec.id), estimates
            )
            on_result(results[spec.id])
        return [results[s.id] for s in specs]
    set_thread_variables()
    with ProcessPoolExecutor(
        min(jobs, len(specs)), mp_context=multiprocessing.get_context("spawn")
    ) as pool:
        waiting = {
            pool.submit(
                replay_trial,
                spec,
                config,
                out,
                review,
                force,
                None,
                known.get(spec.id),
                estimates,
            ): spec
            for spec in specs
        }
        for future in as_completed(waiting):
            spec = waiting[future]
            try:
                result = future.result()
            except BrokenProcessPool:
                result = TrialResult(
                    spec.id, None, EXIT_INTERNAL, ["the worker process died (out of memory?)"], None
                )
            results[spec.id] = result
            on_result(result)
    return [results[s.id] for s in specs]
