"""Catches: marks of the log that the replay doesn't get, or gets of another picture, and a log
without marks that is replayed in silence.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dgeval.errors import UnreadableError
from tests.recording.recorders import COLOUR, Message, image, opened, write
from tests.recording.test_recorded_target import ARRAY_2D, BOX, flat, with_marks

RECORDED = "tracking.method=recorded"


@pytest.fixture(scope="module")
def unmarked(messages: list[Message]) -> list[Message]:
    return [m for m in messages if m[1] != "/dgeval/belief/mask"]


def labels(size: tuple[int, int]) -> Any:
    """Two things of a label image: 1 in a corner, 300 in BOX; size: width, height px."""

    def made(header: Any) -> Any:
        scale = size[0] / 320
        pixels = np.zeros(size[::-1], np.uint16)
        pixels[: round(20 * scale), : round(30 * scale)] = 1
        x0, y0, x1, y1 = (round(v * scale) for v in BOX)
        cv2.rectangle(pixels, (x0, y0), (x1 - 1, y1 - 1), 300, -1)
        return image(type("Like", (), {"header": header}), pixels, "mono16")

    return made


@pytest.mark.parametrize("size", [(320, 240), (160, 120)])
def test_every_frame_gets_what_is_marked_in_it(
    tmp_path: Path, unmarked: list[Message], size: tuple[int, int]
) -> None:
    """Fails where labels are cut to a byte, a mask of half the size is not scaled, a mark goes to
    the next picture, or frames without one say nothing.
    """
    listed = with_marks(unmarked, "/segmentation/mask", "sensor_msgs/msg/Image", labels(size))
    path = write(tmp_path / "a.mcap", listed)
    if size != (320, 240):
        trial = opened(path, RECORDED, "roles.target=/segmentation/mask")
    else:
        trial = opened(path, RECORDED)
    colours = [m for m in unmarked if m[1] == COLOUR]
    marked = [k for k, f in enumerate(trial.frames()) if f.marked]
    assert marked == list(range(2, len(colours), 3))[: len(marked)]
    assert len(marked) > 15
    frame = next(f for f in trial.frames() if f.marked)
    corner, target = frame.marked
    assert (corner.name, target.name) == ("/segmentation/mask#1", "/segmentation/mask#300")
    assert target.box == pytest.approx(BOX)
    assert target.pixels is not None
    assert target.pixels.shape == (80, 80)
    assert target.pixels.all()
    assert any("marks something in" in note for note in trial.notes)


def test_the_names_of_detections_are_kept(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where a tracker's own id is dropped, so that another thing may be taken."""

    def named(header: Any) -> Any:
        listed = flat(header, BOX)
        listed.detections[0].id = "7"
        return listed

    path = write(tmp_path / "a.mcap", with_marks(unmarked, "/detections", ARRAY_2D, named))
    frame = next(f for f in opened(path, RECORDED).frames() if f.marked)
    assert [thing.name for thing in frame.marked] == ["/detections#7"]


def test_a_log_that_marks_nothing_is_refused_with_the_mend(
    tmp_path: Path, unmarked: list[Message]
) -> None:
    """Fails where every frame is lost in silence."""
    path = write(tmp_path / "a.mcap", unmarked)
    with pytest.raises(UnreadableError) as none:
        opened(path, RECORDED)
    assert "no topic holds masks" in none.value.what
    assert "roles.target" in str(none.value.hint)

    def late(header: Any) -> Any:
        header = copy.deepcopy(header)
        header.stamp.sec += 5000
        return flat(header, BOX)

    path = write(tmp_path / "b.mcap", with_marks(unmarked, "/detections", ARRAY_2D, late))
    with pytest.raises(UnreadableError) as apart:
        opened(path, RECORDED)
    assert "/detections marks nothing within 20 ms" in apart.value.what
    assert not opened(path).reader.marked, "another tracker does not ask for marks"


def test_masks_of_another_shape_are_told(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where a square mask is laid over an oblong picture."""
    listed = with_marks(unmarked, "/segmentation/mask", "sensor_msgs/msg/Image", labels((320, 320)))
    path = write(tmp_path / "a.mcap", listed)
    with pytest.raises(UnreadableError) as other:
        opened(path, RECORDED, "roles.target=/segmentation/mask")
    assert "320x320 for pictures of 320x240" in other.value.what
