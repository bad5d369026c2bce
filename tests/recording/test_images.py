"""Catches: 16 bits cut to 8, red and blue swapped, padding or byte order ignored, cut images."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from dgeval.recording.image_codecs.pixels import Pixels
from dgeval.recording.images import colour_from, decode_image, depth_from
from dgeval.recording.messages import cloud_points
from hypothesis import given
from hypothesis import strategies as st

RNG = np.random.default_rng(0)
DEPTH = RNG.integers(0, 65536, (7, 9)).astype(np.uint16)


def raw(
    array: np.ndarray, encoding: str, step: int | None = None, big: bool = False, pad: int = 0
) -> SimpleNamespace:
    """A sensor_msgs/Image of an array, with `pad` bytes of 255 after each row."""
    rows = (
        array.astype(array.dtype.newbyteorder(">" if big else "<"))
        .reshape(array.shape[0], -1)
        .view(np.uint8)
    )
    rows = np.hstack([rows, np.full((len(rows), pad), 255, np.uint8)])
    return SimpleNamespace(
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=int(big),
        step=step if step is not None else rows.shape[1],
        data=rows.ravel(),
    )


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("pad", [0, 6])
def test_raw_depth_is_exact(big: bool, pad: int) -> None:
    """Fails where byte order or padding changes a depth."""
    assert np.array_equal(decode_image(raw(DEPTH, "16UC1", big=big, pad=pad)).array, DEPTH)


def test_raw_colours_keep_their_channels() -> None:
    """Fails where red and blue are swapped."""
    red = np.zeros((4, 5, 3), np.uint8)
    red[..., 0] = 200
    assert np.array_equal(colour_from(decode_image(raw(red, "rgb8"))), red)
    assert np.array_equal(colour_from(decode_image(raw(red[..., ::-1].copy(), "bgr8"))), red)


@pytest.mark.parametrize(
    "text",
    [
        "16UC1; compressedDepth",
        "16UC1; compressedDepth png",
        "16UC1; png compressedDepth",
        "16UC1;compressedDepth",
    ],
)
def test_compressed_depth_round_trip_is_exact(text: str) -> None:
    """Fails where a ROS version's format text is not known, or depth is cut to 8 bits."""
    data = b"\0" * 12 + cv2.imencode(".png", DEPTH)[1].tobytes()
    assert np.array_equal(decode_image(SimpleNamespace(format=text, data=data)).array, DEPTH)


def test_compressed_depth_of_floats() -> None:
    """Fails where image_transport's quantisation, code = a / z + b, is inverted wrongly."""
    z = np.linspace(0.3, 4.0, 60, dtype=np.float32).reshape(6, 10)
    a, b = 100.0 * 4.0 * (4.0 + 1), 1.0 - 100.0 * (4.0 + 1)
    codes = np.round(a / z + b).astype(np.uint16)
    codes[0, 0] = 0
    data = struct.pack("<iff", 0, a, b) + cv2.imencode(".png", codes)[1].tobytes()
    got = depth_from(
        decode_image(SimpleNamespace(format="32FC1; compressedDepth png", data=data)), None
    )
    assert got[0, 0] == 0
    assert np.allclose(got.ravel()[1:], z.ravel()[1:], rtol=0.01)


def test_depth_units_and_missing_readings() -> None:
    """Fails where a unit is wrong, or a missing reading becomes a distance."""
    codes = np.array([[0, 65535, 1000, 250]], np.uint16)
    assert np.allclose(depth_from(decode_image(raw(codes, "16UC1")), None), [[0, 0, 1.0, 0.25]])
    assert np.allclose(depth_from(decode_image(raw(codes, "mono16")), 0.0001), [[0, 0, 0.1, 0.025]])
    metres = np.array([[np.nan, np.inf, -1.0, 0.7]], np.float32)
    assert np.allclose(depth_from(decode_image(raw(metres, "32FC1")), None), [[0, 0, 0, 0.7]])


@pytest.mark.parametrize(
    "message",
    [
        raw(DEPTH, "yuv99"),
        raw(DEPTH, "16UC1", step=4),
        SimpleNamespace(height=7, width=9, encoding="16UC1", is_bigendian=0, step=18, data=b"123"),
        SimpleNamespace(
            format="jpeg",
            data=cv2.imencode(".jpg", np.zeros((40, 40, 3), np.uint8))[1].tobytes()[:-30],
        ),
        SimpleNamespace(format="png", data=cv2.imencode(".png", DEPTH)[1].tobytes()[:40]),
        SimpleNamespace(format="jpeg", data=b"<html>"),
        SimpleNamespace(format="16UC1; compressedDepth rvl", data=b"\0" * 64),
        SimpleNamespace(format="16UC1; compressedDepth png", data=b""),
        SimpleNamespace(other=1),
    ],
)
def test_broken_images_are_value_errors(message: SimpleNamespace) -> None:
    """Fails where a broken image is used, or raises another error."""
    with pytest.raises(ValueError, match=r"."):
        decode_image(message)


@given(st.binary(max_size=200))
def test_random_bytes_never_raise_anything_else(data: bytes) -> None:
    """Fails where damaged bytes let an error of OpenCV or struct through."""
    for text in ("jpeg", "png", "16UC1; compressedDepth png", "32FC1; compressedDepth"):
        with pytest.raises(ValueError, match=r"."):
            decode_image(SimpleNamespace(format=text, data=b"\x89PNG\r\n\x1a\n" + data))


def test_colour_and_depth_are_not_mistaken_for_each_other() -> None:
    """Fails where a topic of the other kind is read as colour or depth."""
    with pytest.raises(ValueError, match="not a colour"):
        colour_from(decode_image(raw(DEPTH, "16UC1")))
    with pytest.raises(ValueError, match="not a depth"):
        depth_from(decode_image(raw(np.zeros((2, 2, 3), np.uint8), "rgb8")), None)


@pytest.mark.parametrize(("kind", "datatype"), [("f4", 7), ("f8", 8)])
@pytest.mark.parametrize("big", [False, True])
def test_clouds_of_any_layout_give_their_points(kind: str, datatype: int, big: bool) -> None:
    """Fails where fields are read by order, or padding, byte order or NaN are not respected."""
    points = RNG.normal(size=(6, 3)).astype(kind)
    points[2] = np.nan
    size = np.dtype(kind).itemsize
    step = 4 + 3 * size + 8
    layout = {
        "names": ["z", "x", "y"],
        "formats": [(">" if big else "<") + kind] * 3,
        "offsets": [4 + size * k for k in range(3)],
    }
    rows = np.zeros(6, np.dtype({**layout, "itemsize": step}))
    for k, name in enumerate("xyz"):
        rows[name] = points[:, k]
    fields = [
        SimpleNamespace(name=n, offset=o, datatype=datatype)
        for n, o in zip("zxy", layout["offsets"], strict=True)
    ]
    data = np.frombuffer(rows.tobytes(), np.uint8)
    cloud = SimpleNamespace(
        fields=fields, is_bigendian=big, point_step=step, width=3, height=2, data=data
    )
    np.testing.assert_array_equal(
        cloud_points(cloud), np.delete(points, 2, axis=0).astype(np.float64)
    )
    cloud.data = data[:-step]
    with pytest.raises(ValueError, match="6 points"):
        cloud_points(cloud)
    cloud.fields = fields[:2]
    with pytest.raises(ValueError, match="x, y, z"):
        cloud_points(cloud)


def test_a_far_value_in_many_pixels_is_no_reading() -> None:
    """Catches 10 m where a driver has nothing, and a far wall thrown away."""
    near = np.linspace(0.4, 1.2, 100, dtype=np.float32).reshape(10, 10)
    filled = near.copy()
    filled[:3] = 10.0
    read = depth_from(Pixels(filled, "32FC1"), None)
    assert (read[:3] == 0).all()
    assert (read[3:] == near[3:]).all()
    assert not depth_from(Pixels(np.full((4, 4), 10.0, np.float32), "32FC1"), None).any()
    wall = near.copy()
    wall[:3] = 4.0
    assert (depth_from(Pixels(wall, "32FC1"), None) == wall).all()
    hall = np.linspace(1.0, 9.0, 100, dtype=np.float32).reshape(10, 10)
    hall[0] = 9.0
    assert (depth_from(Pixels(hall, "32FC1"), None) == hall).all()
