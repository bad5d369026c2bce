"""One file of training data per procedural object, made in worker processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from dgeval.determinism import set_thread_variables


def write_all(
    make: Callable[[int], Path], objects: Sequence[int], jobs: int, progress: Callable[[Path], None]
) -> list[Path]:
    """Call `make` with each object's number; returns the files that it wrote, in that order.

    make: must be picklable. progress: called with each file. The files are the same for any number
    of jobs.
    """
    if jobs == 1:
        paths = []
        for index in objects:
            paths.append(make(index))
            progress(paths[-1])
        return paths
    set_thread_variables()
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = [pool.submit(make, index) for index in objects]
        for future in waiting:
            progress(future.result())
        return [future.result() for future in waiting]
