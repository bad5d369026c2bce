"""Catches a review whose timeline up to the decisive moment lacks what the other one has."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.rerun_view import DECISIVE, TIMELINE, ReviewWriter


class Recorder:
    """Stands for a recording stream: notes on which timelines each entity is logged."""

    def __init__(self) -> None:
        self.now: dict[str, float] = {}
        self.logged: list[tuple[str, dict[str, float]]] = []

    def set_time(self, timeline: str, duration: float) -> None:
        self.now[timeline] = duration

    def reset_time(self) -> None:
        self.now = {}

    def log(self, entity: str, *_: object, static: bool = False) -> None:
        self.logged.append((entity, {} if static else dict(self.now)))

    def __getattr__(self, _: str) -> Any:
        return lambda *a, **k: None


@pytest.mark.parametrize("decisive_s", [None, 3.0])
def test_the_distance_is_drawn_up_to_the_end_of_a_hand_that_never_closed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, decisive_s: float | None
) -> None:
    """Fails where a trial without a decisive moment opens with an empty plot of the distance."""
    nearest: list[int] = []
    monkeypatch.setattr("dgeval.rerun_view._blueprint", lambda *_: None)
    monkeypatch.setattr(ReviewWriter, "_log_decisive", lambda *_: None)
    monkeypatch.setattr(ReviewWriter, "_log_nearest", lambda *a: nearest.append(a[3]))
    writer: Any = ReviewWriter.__new__(ReviewWriter)
    writer._rec, writer._start_ns, writer._first_lost_ns = Recorder(), 0, None
    writer._path, writer._image_bytes = tmp_path / "a.rrd", 0
    writer._path.write_bytes(b"x")
    stamps = [k * 10**9 for k in range(5)]
    writer._moments = [SimpleNamespace(t_ns=t) for t in stamps]
    hindsight: Any = SimpleNamespace(
        path=SimpleNamespace(at=lambda _: np.eye(4), centroid=np.zeros(3)),
        sightings=(),
        moments=[SimpleNamespace(t_ns=t, distance=0.01) for t in stamps],
    )
    decisive_ns = None if decisive_s is None else round(decisive_s * 1e9)
    judgement: Any = SimpleNamespace(
        decisive_ns=decisive_ns, link=None, row=SimpleNamespace(evidence="never closed")
    )
    writer.close(tmp_path / "b.rrd", hindsight, judgement)
    drawn = [times for entity, times in writer._rec.logged if entity == "plots/distance"]
    assert [times[TIMELINE] for times in drawn] == [0.0, 1.0, 2.0, 3.0, 4.0]
    end_s = 4.0 if decisive_s is None else decisive_s
    assert [t[DECISIVE] for t in drawn if DECISIVE in t] == [end_s - 2.0, end_s - 1.0, end_s]
    assert nearest == ([] if decisive_ns is None else [decisive_ns])
