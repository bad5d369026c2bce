"""Catches: a model of one view that refuses for ever, and one that takes in what does not agree
with itself.

A flat thing 0.5 m before the camera that stands still and is registered right. Its mask shows
a part of it at first and then some more: within the search radius of the model, but not of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.geometry import Intrinsics
from dgeval.perception.pipeline import NEAR_ALL, REFUSED_FRAMES, Perceived, Perception
from dgeval.perception.registration import fit
from dgeval.perception.trackers.model import TrackingInput
from dgeval.perception.types import Tracked
from dgeval.recording.frame import Frame

CAMERA = Intrinsics(320, 240, 290.0, 290.0, 160.0, 120.0)
WINDOW = (100, 80, 200, 160)
HALF, MORE = 24, 32  # px, columns of the window in the mask at first, and then
N = 12

Depth = Callable[[int], float]


class Masked:
    """A tracker that shows HALF of the window in the first frame and MORE in the others."""

    def step(self, given: TrackingInput) -> Tracked:
        columns = HALF if given.frame.index == 0 else MORE
        mask = np.zeros((80, 100), dtype=bool)
        mask[:, :columns] = True
        box, area = (100.0, 80.0, 200.0, 160.0), int(mask.sum())
        return Tracked("tracked", box, WINDOW, mask, area, np.eye(4))


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "dgeval.perception.pipeline.register",
        lambda seen, model, T, features, camera, config, noise: fit(seen, model, T, config, noise),
    )


def perceived(added: Depth) -> list[Perceived]:
    """added(k): m, how much nearer the columns from HALF to MORE are than the rest in frame k."""
    perception = Perception(load_config("dynamic", ("registration.c_a_f=0.9",)))
    perception.tracker = Masked()
    rng, out = np.random.default_rng(3), []
    for k in range(N):
        depth = 0.5 + rng.normal(0, 0.0005, (240, 320))
        depth[80:160, WINDOW[0] + HALF : WINDOW[0] + MORE] -= added(k)
        frame = Frame(
            k,
            k * 33_000_000,
            np.zeros((240, 320, 3), np.uint8),
            depth.astype(np.float32),
            CAMERA,
            np.eye(4),
            None,
        )
        box = (100.0, 80.0, 200.0, 160.0) if k == 0 else None
        out.append(perception.step(frame, np.eye(4), box, lambda _: None))
    return out


def test_after_three_refusals_frames_that_agree_are_merged() -> None:
    """Fails where a side that came into view is refused as long as the log lasts."""
    steps = perceived(lambda k: 0.0)
    refused = [s.fused.reject_reason for s in steps]
    assert refused[1 : 1 + REFUSED_FRAMES] == ["fitness"] * REFUSED_FRAMES
    assert all(s.registration is not None and s.registration.fitness > NEAR_ALL for s in steps[1:])
    assert refused[1 + REFUSED_FRAMES :] == [None] * (N - 1 - REFUSED_FRAMES)
    first, last = steps[0].model, steps[-1].model
    assert first is not None
    assert last is not None
    assert np.ptp(last.points[:, 0]) > 1.2 * np.ptp(first.points[:, 0]), "it must learn the side"


def test_what_moves_from_frame_to_frame_is_refused() -> None:
    """Fails where three refusals open the gate for what one of them shows: what is added stands
    10 mm nearer in every other frame.
    """
    steps = perceived(lambda k: 0.01 * (k % 2))
    assert all(s.registration is not None and s.registration.fitness > NEAR_ALL for s in steps[1:])
    assert [s.fused.reject_reason for s in steps[1:]] == ["fitness"] * (N - 1)


def test_what_is_far_from_the_model_never_counts() -> None:
    """Fails where a thing beside the target, farther than the search radius, is merged in time."""
    steps = perceived(lambda k: 0.03)
    assert not any(s.accepted for s in steps[1:])
