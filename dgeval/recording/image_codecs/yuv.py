"""sensor_msgs/Image in YUV: packed 4:2:2, and 4:2:0 or 4:4:4 with separate colour planes.

The conversion is in whole numbers, so that every CPU gives the same picture.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgeval.recording.image_codecs.pixels import Pixels

Plane = NDArray[np.uint8]

# order of the bytes of two pixels: y0, u, y1, v. "yuv422" is ROS's older name of UYVY.
PACKED = {
    "uyvy": (1, 0, 3, 2),
    "yuv422": (1, 0, 3, 2),
    "yuyv": (0, 1, 2, 3),
    "yuv422_yuy2": (0, 1, 2, 3),
}
# subsampling of the colour plane (across, down), and whether u comes first
PLANAR = {"nv12": (2, 2, True), "nv21": (2, 2, False), "nv24": (1, 1, True)}
# kr, kb: the weights of red and blue in luma, ITU-R BT.601, BT.709 and BT.2020
LUMA = {"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "bt2020": (0.2627, 0.0593)}
SHIFT = 16  # bits of the fixed-point factors

ORDER = 5  # kinds with a lower number are asked first


def accepts(message: Any) -> bool:
    encoding = getattr(message, "encoding", None)
    return hasattr(message, "step") and (encoding in PACKED or encoding in PLANAR)


def decode(message: Any) -> Pixels:
    """rgb8 by BT.601 with limited range, as cameras and cv_bridge mean it.

    ValueError for too few bytes, or a size that the subsampling does not divide.
    """
    data = np.frombuffer(memoryview(message.data), dtype=np.uint8)
    size = int(message.width), int(message.height), int(message.step)
    if message.encoding in PACKED:
        y, u, v = _packed(data, *size, PACKED[message.encoding])
    else:
        y, u, v = _planar(data, *size, *PLANAR[message.encoding])
    return Pixels(rgb_from(y, u, v), "rgb8")


def _packed(
    data: Plane, width: int, height: int, step: int, order: tuple[int, int, int, int]
) -> tuple[Plane, Plane, Plane]:
    if width <= 0 or height <= 0 or width % 2 or step < 2 * width or len(data) < step * height:
        raise ValueError(f"{len(data)} bytes are not {width}x{height} YUV 4:2:2 with step {step}")
    pairs = data[: step * height].reshape(height, step)[:, : 2 * width]
    y0, u, y1, v = (pairs.reshape(height, width // 2, 4)[:, :, k] for k in order)
    return np.stack([y0, y1], axis=2).reshape(height, width), u, v


def _planar(
    data: Plane, width: int, height: int, step: int, across: int, down: int, u_first: bool
) -> tuple[Plane, Plane, Plane]:
    row = 2 * step // across  # bytes of a row of u and v in turn
    needed = step * height + row * (height // down)
    fits = width > 0 and height > 0 and not width % across and not height % down
    if not fits or step < width or len(data) < needed:
        raise ValueError(f"{len(data)} bytes are not {width}x{height} YUV with step {step}")
    y = data[: step * height].reshape(height, step)[:, :width]
    colour = data[step * height : needed].reshape(height // down, row)[:, : 2 * width // across]
    first, second = colour[:, ::2], colour[:, 1::2]
    return (y, first, second) if u_first else (y, second, first)


def rgb_from(y: Plane, u: Plane, v: Plane, weights: str = "bt601", full: bool = False) -> Plane:
    """(H, W, 3) RGB of planes of luma (H, W) and colour, whose samples are repeated.

    u, v: (H / n, W / m), rounded up. weights: a key of `LUMA`. full: luma uses 0 to 255 and not
    16 to 235.
    """
    height, width = y.shape
    m, n = -(-width // u.shape[1]), -(-height // u.shape[0])
    kr, kb = LUMA[weights]
    luma, chroma = (1.0, 1.0) if full else (255 / 219, 255 / 224)

    def fixed(factor: float) -> int:
        return round(factor * (1 << SHIFT))

    half = 1 << (SHIFT - 1)
    light = np.maximum(y.astype(np.int32) - (0 if full else 16), 0) * fixed(luma) + half
    du, dv = u.astype(np.int32) - 128, v.astype(np.int32) - 128
    parts = (
        dv * fixed(2 * (1 - kr) * chroma),
        du * fixed(-2 * (1 - kb) * kb / (1 - kr - kb) * chroma)
        + dv * fixed(-2 * (1 - kr) * kr / (1 - kr - kb) * chroma),
        du * fixed(2 * (1 - kb) * chroma),
    )
    out = np.empty((height, width, 3), np.uint8)
    for k, part in enumerate(parts):
        spread = np.repeat(np.repeat(part, n, axis=0)[:height], m, axis=1)[:, :width]
        out[:, :, k] = np.clip((light + spread) >> SHIFT, 0, 255)
    return out
