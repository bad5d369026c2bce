"""Catches what the stage around TransT loses: its mask, its doubt, the hand in it, its frames.

The network is put in the place of one that knows the truth; tests/networks has the real one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.errors import UsageError
from dgeval.geometry import Box
from dgeval.networks import transt_loop
from dgeval.networks.transt_loop import Sighting
from dgeval.perception.trackers import transt as stage
from dgeval.perception.trackers.model import TrackingInput
from dgeval.perception.trackers.transt import TransTTracker
from dgeval.perception.types import Tracked
from test_tracking import finger, make, run, slide

SETTINGS = ("tracking.method=transt", "tracking.weights=made.pth")
DOUBTED = (5, 6)  # frames in which the network's score is low


class Knowing:
    """In place of the loop: each frame's true box, with a mask that is too large by far."""

    boxes: list[Any] = []  # noqa: RUF012 - set by each test
    has_mask = True
    given: tuple[Any, ...] = ()

    def __init__(self, *settings: object) -> None:
        self.settings, self.k = settings, 0

    def start(self, image: np.ndarray, box: Box) -> None:
        self.k = 0
        Knowing.given = (*self.settings, image, box)

    def step(self, image: np.ndarray) -> Sighting:
        self.k += 1
        box = Knowing.boxes[self.k]
        probability = np.zeros(image.shape[:2], np.float32)
        x0, y0, x1, y1 = (round(v) for v in box)
        probability[y0 - 6 : y1 + 6, x0 - 6 : x1 + 6] = 0.5  # below the threshold
        probability[y0:y1, x0:x1] = 0.9
        score = 0.1 if self.k in DOUBTED else 0.8
        return Sighting(box, score, 0.7, probability if Knowing.has_mask else None)


@pytest.fixture(autouse=True)
def knowing(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(stage, "transt_of", lambda weights: weights)
    monkeypatch.setattr(transt_loop, "TransTLoop", Knowing)
    yield
    Knowing.has_mask = True


@pytest.mark.parametrize("has_mask", [True, False])
def test_a_sliding_box_is_followed_and_doubt_is_a_loss(has_mask: bool) -> None:
    """Catches a doubted frame that is used, a loss that stays, a score that isn't said."""
    frames, boxes = make(20, slide)
    Knowing.boxes, Knowing.has_mask = boxes, has_mask
    steps = run(frames, boxes[0], *SETTINGS)
    states = [step.tracked.state for step in steps]
    assert states == ["lost" if k in DOUBTED else "tracked" for k in range(20)]
    assert [k for k, s in enumerate(steps) if s.tracked.reacquired] == [DOUBTED[-1] + 1]
    assert steps[3].row["track_confidence"] == pytest.approx(0.8)
    assert [k for k, s in enumerate(steps) if s.row["icp_reject_reason"]] == list(DOUBTED)
    assert steps[-1].row["velocity_x"] == pytest.approx(0.12, abs=0.02)
    assert abs(steps[-1].row["velocity_y"]) < 0.02


def first_two(frames: list[Any], boxes: list[Any]) -> tuple[Tracked, Tracked]:
    tracker = TransTTracker(load_config("dynamic", SETTINGS))
    Knowing.boxes = boxes
    first = tracker.step(TrackingInput(frames[0], boxes[0], None, None, None, False))
    return first, tracker.step(TrackingInput(frames[1], None, None, None, None, False))


def test_the_mask_is_what_the_network_is_sure_of() -> None:
    """Catches pixels of the search crop that were doubted, and a window taken for the image."""
    frames, boxes = make(2, slide)
    _, second = first_two(frames, boxes)
    assert second.window is not None
    assert second.mask is not None
    v, u = np.nonzero(second.mask)
    u, v = u + second.window[0], v + second.window[1]
    x0, y0, x1, y1 = boxes[1]
    assert x0 <= u.min() < u.max() < x1
    assert y0 <= v.min() < v.max() < y1
    assert second.mask_area == len(u) > 0.5 * (x1 - x0) * (y1 - y0)


def test_the_hand_is_no_part_of_the_mask() -> None:
    """Catches a finger in the network's mask that goes into the model."""
    frames, boxes = make(2, slide, hand=finger)
    _, second = first_two(frames, boxes)
    unknown = [type(f)(**{**f.__dict__, "hand": None}) for f in frames]
    _, with_finger = first_two(unknown, boxes)
    assert second.mask_area < 0.97 * with_finger.mask_area


def test_the_network_gets_the_settings_and_the_picture_as_it_is() -> None:
    """Catches settings that nobody reads, and blue taken for red."""
    frames, boxes = make(2, slide)
    Knowing.boxes = boxes
    more = ("tracking.window_weight=0.3", "tracking.update_iou=0.7", "tracking.lost_below=0.2")
    tracker = TransTTracker(load_config("dynamic", (*SETTINGS, *more)))
    tracker.step(TrackingInput(frames[0], boxes[0], None, None, None, False))
    *settings, image, box = Knowing.given
    assert settings == ["made.pth", 0.3, 0.7, 0.2]
    assert np.array_equal(image, frames[0].colour)
    assert box == boxes[0]


def test_a_target_that_leaves_the_image_is_lost_and_a_new_box_starts_again() -> None:
    """Catches a box outside the image that is used, and a target of the trial before."""
    frames, boxes = make(3, slide)
    x0, y0, x1, y1 = boxes[1]
    Knowing.boxes = [boxes[0], (x0 - x1 + 8.0, y0, 8.0, y1), boxes[2]]
    tracker = TransTTracker(load_config("dynamic", SETTINGS))
    tracker.step(TrackingInput(frames[0], boxes[0], None, None, None, False))
    given = TrackingInput(frames[1], None, None, None, None, False)
    assert tracker.step(given).state == "lost"
    tracker.reset()
    assert tracker.step(given).state == "not_started"
    again = tracker.step(TrackingInput(frames[2], boxes[2], None, None, None, False))
    assert (again.state, again.reacquired) == ("tracked", False)


def test_nothing_is_told_before_a_box_is_given() -> None:
    frames, boxes = make(2, slide)
    Knowing.boxes = boxes
    tracker = TransTTracker(load_config("dynamic", SETTINGS))
    assert tracker.step(TrackingInput(frames[0], None, None, None, None, False)).state == (
        "not_started"
    )


def test_the_method_needs_weights_and_they_need_it() -> None:
    with pytest.raises(UsageError, match=r"needs tracking\.weights, a file of the authors"):
        load_config("dynamic", SETTINGS[:1])
    with pytest.raises(UsageError, match=r'with tracking\.method = "transt" only'):
        load_config("dynamic", SETTINGS[1:])
