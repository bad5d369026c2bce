"""Catches: planes read in the wrong order, a wrong matrix, colours shifted, lower bytes taken."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from dgeval.recording.image_codecs import yuv
from dgeval.recording.images import colour_from, decode_image
from hypothesis import given
from hypothesis import strategies as st

RNG = np.random.default_rng(3)


def scene() -> np.ndarray:
    """A smooth picture (24, 32, 3) RGB of distinct colours in its corners."""
    corners = np.array([[[220, 30, 40], [40, 200, 60]], [[30, 60, 210], [200, 190, 40]]], np.uint8)
    return cv2.resize(corners, (32, 24), interpolation=cv2.INTER_LINEAR)


def message(encoding: str, array: np.ndarray, width: int, height: int, step: int) -> object:
    return SimpleNamespace(
        encoding=encoding, width=width, height=height, step=step, is_bigendian=0, data=array.ravel()
    )


@pytest.mark.parametrize(
    ("encoding", "code"),
    [
        ("uyvy", cv2.COLOR_YUV2RGB_UYVY),
        ("yuv422", cv2.COLOR_YUV2RGB_UYVY),
        ("yuyv", cv2.COLOR_YUV2RGB_YUY2),
        ("yuv422_yuy2", cv2.COLOR_YUV2RGB_YUY2),
    ],
)
def test_packed_yuv_is_what_cv_bridge_gives(encoding: str, code: int) -> None:
    """Fails where the order of the bytes or the matrix is another one."""
    data = RNG.integers(0, 256, (24, 32, 2)).astype(np.uint8)
    got = colour_from(decode_image(message(encoding, data, 32, 24, 64)))
    assert np.abs(got.astype(int) - cv2.cvtColor(data, code).astype(int)).max() <= 1


@pytest.mark.parametrize(
    ("encoding", "code"), [("nv12", cv2.COLOR_YUV2RGB_NV12), ("nv21", cv2.COLOR_YUV2RGB_NV21)]
)
def test_planes_of_half_size(encoding: str, code: int) -> None:
    """Fails where u and v are swapped, or a colour lands on other pixels."""
    data = RNG.integers(0, 256, (36, 32)).astype(np.uint8)
    got = colour_from(decode_image(message(encoding, data, 32, 24, 32)))
    assert np.abs(got.astype(int) - cv2.cvtColor(data, code).astype(int)).max() <= 1


def test_planes_of_full_size_have_the_padding_of_their_rows() -> None:
    """Fails where a row's padding becomes pixels (nv24)."""
    y = RNG.integers(16, 236, (24, 32)).astype(np.uint8)
    u, v = RNG.integers(16, 241, (2, 24, 32)).astype(np.uint8)
    padded = np.zeros((24 + 48, 40), np.uint8)
    padded[:24, :32] = y
    padded[24:].reshape(24, 80)[:, :64] = np.stack([u, v], axis=2).reshape(24, 64)
    got = colour_from(decode_image(message("nv24", padded, 32, 24, 40)))
    assert np.array_equal(got, yuv.rgb_from(y, u, v))


@given(st.sampled_from(sorted(yuv.LUMA)), st.booleans(), st.tuples(*[st.integers(0, 255)] * 3))
def test_grey_stays_grey_and_white_stays_white(
    weights: str, full: bool, colour: tuple[int, int, int]
) -> None:
    """Fails where a matrix has a wrong sign or range; the way back is the standard's formula."""
    kr, kb = yuv.LUMA[weights]
    r, g, b = (c / 255 for c in colour)
    light = kr * r + (1 - kr - kb) * g + kb * b
    pb, pr = (b - light) / (2 * (1 - kb)), (r - light) / (2 * (1 - kr))
    low, high, span = (0, 255, 255) if full else (16, 219, 224)
    codes = low + high * light, 128 + span * pb, 128 + span * pr
    planes = [np.full((2, 2), np.clip(round(c), 0, 255), np.uint8) for c in codes]
    assert np.abs(yuv.rgb_from(*planes, weights, full)[0, 0].astype(int) - colour).max() <= 3


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_colour_filter_gives_the_picture_back(pattern: str, bits: int) -> None:
    """Fails where a pattern's letters are read in OpenCV's order, or red and blue are swapped."""
    picture = scene()
    grid = np.array(list(pattern)).reshape(2, 2)
    filtered = np.zeros((24, 32), np.uint16 if bits == 16 else np.uint8)
    for row in range(2):
        for column in range(2):
            channel = "rgb".index(grid[row, column])
            filtered[row::2, column::2] = picture[row::2, column::2, channel]
    if bits == 16:
        filtered *= 257
    encoding = f"bayer_{pattern}{bits}"
    got = colour_from(
        decode_image(message(encoding, filtered.view(np.uint8), 32, 24, 32 * bits // 8))
    )
    inside = np.s_[3:-3, 3:-3]
    assert np.abs(got[inside].astype(int) - picture[inside].astype(int)).max() <= 16


def test_pictures_of_16_bits_keep_their_light() -> None:
    """Fails where the lower byte is taken, as raw or inside a PNG."""
    picture = scene()
    wide = picture.astype(np.uint16) * 257
    got = colour_from(decode_image(message("rgb16", wide.view(np.uint8), 32, 24, 32 * 6)))
    assert np.array_equal(got, picture)
    png = cv2.imencode(".png", wide[..., ::-1])[1].tobytes()
    packed = SimpleNamespace(format="rgb16; png compressed bgr16", data=png)
    assert np.array_equal(colour_from(decode_image(packed)), picture)


@pytest.mark.parametrize(
    "encoding", ["uyvy", "yuyv", "nv12", "nv21", "nv24", "bayer_rggb8", "rgb16"]
)
@given(st.integers(-2, 40), st.integers(-2, 40), st.integers(-1, 90), st.integers(0, 4000))
def test_sizes_that_do_not_fit_are_refused(
    encoding: str, width: int, height: int, step: int, n_bytes: int
) -> None:
    """Fails where an image that lies about its size gives anything but ValueError or its size."""
    data = np.zeros(n_bytes, np.uint8)
    try:
        got = decode_image(message(encoding, data, width, height, step))
    except ValueError:
        return
    assert got.array.shape[:2] == (height, width)
