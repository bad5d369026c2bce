"""sensor_msgs/Image: any step, either endianness."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgeval.recording.image_codecs.pixels import Pixels, eight_bit

# sensor_msgs encodings: type of an element, elements per pixel
LAYOUTS = {
    "rgb8": (np.uint8, 3),
    "bgr8": (np.uint8, 3),
    "rgba8": (np.uint8, 4),
    "bgra8": (np.uint8, 4),
    "mono8": (np.uint8, 1),
    "8UC1": (np.uint8, 1),
    "8UC3": (np.uint8, 3),
    "8UC4": (np.uint8, 4),
    "16UC1": (np.uint16, 1),
    "mono16": (np.uint16, 1),
    "Z16": (np.uint16, 1),
    "32FC1": (np.float32, 1),
    "32SC1": (np.int32, 1),  # of a segmentation's labels
    "rgb16": (np.uint16, 3),
    "bgr16": (np.uint16, 3),
    "16UC3": (np.uint16, 3),
    "rgba16": (np.uint16, 4),
    "bgra16": (np.uint16, 4),
}
# colour of 16 bits is given with 8
EIGHT_BIT = {
    "rgb16": "rgb8",
    "bgr16": "bgr8",
    "16UC3": "bgr8",
    "rgba16": "rgba8",
    "bgra16": "bgra8",
}


ORDER = 10  # kinds with a lower number are asked first


def accepts(message: Any) -> bool:
    return hasattr(message, "encoding") and hasattr(message, "step")


def decode(message: Any) -> Pixels:
    """ValueError for an unknown encoding, or fewer bytes than the header needs."""
    if message.encoding not in LAYOUTS:
        raise ValueError(f"image encoding {message.encoding!r} is not one of {', '.join(LAYOUTS)}")
    dtype, channels = LAYOUTS[message.encoding]
    item = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    height, width = int(message.height), int(message.width)
    row = width * channels * item.itemsize
    step = int(message.step) or row  # some drivers leave it out
    data = np.frombuffer(memoryview(message.data), dtype=np.uint8)
    if height <= 0 or width <= 0 or step < row or len(data) < step * (height - 1) + row:
        raise ValueError(
            f"{len(data)} bytes are not {width}x{height} {message.encoding} with step {step}"
        )
    if len(data) < step * height:  # the padding of the last row may be missing
        data = np.concatenate([data, np.zeros(step * height - len(data), np.uint8)])
    rows = data[: step * height].reshape(height, step)[:, :row]
    array = (
        np.ascontiguousarray(rows)
        .view(item)
        .reshape(height, width, channels)
        .astype(dtype, copy=False)
    )
    if message.encoding in EIGHT_BIT:
        return Pixels(eight_bit(array), EIGHT_BIT[message.encoding])
    unit = getattr(message, "depth_unit", None)  # of librealsense's recorder
    return Pixels(array[:, :, 0] if channels == 1 else array, message.encoding, unit)
