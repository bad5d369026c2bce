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
from dgeval.recording.pairing import Pair
from dgeval.recording.recorded_target import near_enough
from tests.recording.recorders import COLOUR, TYPES, Message, image, of, opened, write
from tests.recording.test_recorded_target import ARRAY_2D, BOX, flat, with_marks

RECORDED = "tracking.method=recorded"


@pytest.fixture(scope="module")
def unmarked(messages: list[Message]) -> list[Message]:
    return [m for m in messages if m[1] != "/dgeval/belief/mask"]


def labels(size: tuple[int, int], kind: str = "mono16") -> Any:
    """Two things of a label image: 1 in a corner, 300 in BOX; size: width, height px."""

    def made(header: Any) -> Any:
        scale = size[0] / 320
        pixels = np.zeros(size[::-1], np.int32 if kind == "32SC1" else np.uint16)
        pixels[: round(20 * scale), : round(30 * scale)] = 1
        x0, y0, x1, y1 = (round(v * scale) for v in BOX)
        cv2.rectangle(pixels, (x0, y0), (x1 - 1, y1 - 1), 300, -1)
        return image(type("Like", (), {"header": header}), pixels, kind)

    return made


@pytest.mark.parametrize(
    ("size", "kind"), [((320, 240), "mono16"), ((160, 120), "mono16"), ((320, 240), "32SC1")]
)
def test_every_frame_gets_what_is_marked_in_it(
    tmp_path: Path, unmarked: list[Message], size: tuple[int, int], kind: str
) -> None:
    """Fails where labels are cut to a byte, a mask of half the size is not scaled, a mark goes to
    the next picture, or frames without one say nothing.
    """
    listed = with_marks(unmarked, "/segmentation/mask", "sensor_msgs/msg/Image", labels(size, kind))
    path = write(tmp_path / "a.mcap", listed)
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


def test_names_and_scores_of_detections_are_kept(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where a tracker's own id is dropped, so that another thing may be taken, or its score,
    so that nothing says how sure it is.
    """

    def named(header: Any) -> Any:
        listed = flat(header, BOX)
        listed.detections[0].id = "7"
        at = TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=TYPES["geometry_msgs/msg/Pose"](
                position=TYPES["geometry_msgs/msg/Point"](x=0.0, y=0.0, z=0.0),
                orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            ),
            covariance=np.zeros(36),
        )
        listed.detections[0].results = [
            of(
                "ObjectHypothesisWithPose",
                hypothesis=of("ObjectHypothesis", class_id="mug", score=score),
                pose=at,
            )
            for score in (0.3, 0.75)
        ]
        return listed

    path = write(tmp_path / "a.mcap", with_marks(unmarked, "/detections", ARRAY_2D, named))
    frame = next(f for f in opened(path, RECORDED).frames() if f.marked)
    assert [thing.name for thing in frame.marked] == ["/detections#7"]
    assert frame.marked[0].score == 0.75


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
    assert "stamps of /detections are 5000.0 s ahead" in apart.value.what
    assert not opened(path).reader.marked, "another tracker does not ask for marks"


def test_masks_of_another_shape_are_told(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where a square mask is laid over an oblong picture."""
    listed = with_marks(unmarked, "/segmentation/mask", "sensor_msgs/msg/Image", labels((320, 320)))
    path = write(tmp_path / "a.mcap", listed)
    with pytest.raises(UnreadableError) as other:
        opened(path, RECORDED, "roles.target=/segmentation/mask")
    assert "320x320 for pictures of 320x240" in other.value.what


def compressed(header: Any, pixels: np.ndarray, kind: str) -> Any:
    data = cv2.imencode(f".{kind}", pixels)[1]
    return TYPES["sensor_msgs/msg/CompressedImage"](header=header, format=kind, data=data)


def binary() -> np.ndarray:
    pixels = np.zeros((240, 320), np.uint8)
    cv2.circle(pixels, (200, 110), 40, 255, -1)
    return pixels


def blurred(header: Any) -> Any:
    soft = cv2.GaussianBlur(binary(), (7, 7), 2.0)
    return image(type("Like", (), {"header": header}), soft, "mono8")


@pytest.mark.parametrize(
    ("kind", "make"),
    [
        ("sensor_msgs/msg/CompressedImage", lambda h: compressed(h, binary(), "jpg")),
        ("sensor_msgs/msg/CompressedImage", lambda h: compressed(h, binary(), "png")),
        ("sensor_msgs/msg/Image", blurred),
    ],
)
def test_masks_with_blurred_values_are_one_thing(
    tmp_path: Path, unmarked: list[Message], kind: str, make: Any
) -> None:
    """Fails where the values that JPEG or soft edges make are other things, so that the mask
    shrinks, or is refused.
    """
    path = write(tmp_path / "a.mcap", with_marks(unmarked, "/segmentation/mask", kind, make))
    frame = next(f for f in opened(path, RECORDED).frames() if f.marked)
    (thing,) = frame.marked
    assert thing.pixels is not None
    assert thing.pixels.sum() == pytest.approx((binary() > 0).sum(), rel=0.05)


def test_colours_of_a_mask_are_its_things(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where one channel is read: two things of equal red become one, and green ones none."""

    def coloured(header: Any) -> Any:
        pixels = np.zeros((240, 320, 3), np.uint8)
        pixels[100:140, 40:80] = (200, 0, 50)
        pixels[100:140, 180:220] = (200, 90, 0)
        pixels[20:60, 180:220] = (0, 90, 0)
        return image(type("Like", (), {"header": header}), pixels, "rgb8")

    listed = with_marks(unmarked, "/segmentation/mask", "sensor_msgs/msg/Image", coloured)
    path = write(tmp_path / "a.mcap", listed)
    frame = next(
        f for f in opened(path, RECORDED, "roles.target=/segmentation/mask").frames() if f.marked
    )
    boxes = sorted(thing.box for thing in frame.marked)
    assert boxes == [(40, 100, 80, 140), (180, 20, 220, 60), (180, 100, 220, 140)]
    assert len({thing.name for thing in frame.marked}) == 3


def test_each_message_of_a_picture_marks_a_thing(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where one binary mask for each thing leaves the first alone."""

    def one(x: int) -> Any:
        def made(header: Any) -> Any:
            pixels = np.zeros((240, 320), np.uint8)
            pixels[100:140, x : x + 40] = 255
            return image(type("Like", (), {"header": header}), pixels, "mono8")

        return made

    kind = "sensor_msgs/msg/Image"
    listed = with_marks(unmarked, "/segmentation/mask", kind, one(20))
    listed = with_marks(listed, "/segmentation/mask", kind, one(180))
    frame = next(
        f for f in opened(write(tmp_path / "a.mcap", listed), RECORDED).frames() if f.marked
    )
    assert sorted(thing.box[0] for thing in frame.marked) == [20.0, 180.0]


@pytest.mark.parametrize(("period_ms", "near_ms"), [(33, 13), (100, 20)])
def test_a_late_stamp_does_not_mark_the_next_picture(period_ms: int, near_ms: int) -> None:
    """Fails where 20 ms, more than half of the time between two pictures at 30 Hz, is near enough:
    marks that are 18 ms late would be those of the next picture.
    """
    pairs = tuple(Pair(k * period_ms * 1_000_000, k, k) for k in range(9))
    assert near_enough(pairs) // 1_000_000 == near_ms


def test_masks_that_cannot_be_decoded_are_damage(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where a truncated mask counts as a frame without the target."""
    count = iter(range(1000))

    def cut(header: Any) -> Any:
        message = compressed(header, binary(), "png")
        if next(count) >= 3:
            message.data = message.data[:40]
        return message

    kind = "sensor_msgs/msg/CompressedImage"
    trial = opened(
        write(tmp_path / "a.mcap", with_marks(unmarked, "/segmentation/mask", kind, cut)), RECORDED
    )
    assert any("/segmentation/mask: can't be decoded" in d.what for d in trial.damage)
    assert sum(bool(f.marked) for f in trial.frames()) == 3


def test_why_marks_are_not_used_is_told(tmp_path: Path, unmarked: list[Message]) -> None:
    """Fails where every refusal is said to be one of stamps."""

    def elsewhere(header: Any) -> Any:
        header = copy.deepcopy(header)
        header.frame_id = "yolo_input"
        return flat(header, BOX)

    path = write(tmp_path / "a.mcap", with_marks(unmarked, "/detections", ARRAY_2D, elsewhere))
    with pytest.raises(UnreadableError) as other:
        opened(path, RECORDED)
    assert "/detections: of yolo_input, while the camera is" in other.value.what
