"""sensor_msgs/Image as the sensor's colour filter gives it (Bayer), 8 or 16 bit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from dgeval.recording.image_codecs import raw
from dgeval.recording.image_codecs.pixels import Pixels, eight_bit

PATTERNS = {
    "bayer_rggb": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg": cv2.COLOR_BayerGRBG2RGB,
}
DEPTHS = {"8": "mono8", "16": "mono16"}

ORDER = 6  # kinds with a lower number are asked first


def _parts(message: Any) -> tuple[str, str]:
    """The pattern, and the encoding of the bare numbers; "" for another kind."""
    encoding = str(getattr(message, "encoding", ""))
    for bits, bare in DEPTHS.items():
        if encoding.endswith(bits) and encoding.removesuffix(bits) in PATTERNS:
            return encoding.removesuffix(bits), bare
    return "", ""


def accepts(message: Any) -> bool:
    return hasattr(message, "step") and bool(_parts(message)[0])


def decode(message: Any) -> Pixels:
    """rgb8, each pixel's missing colours from its neighbours (bilinear).

    ValueError for too few bytes.
    """
    pattern, bare = _parts(message)
    fields = ("width", "height", "step", "is_bigendian", "data")
    grey = SimpleNamespace(encoding=bare, **{name: getattr(message, name) for name in fields})
    array = cv2.cvtColor(raw.decode(grey).array, PATTERNS[pattern])
    return Pixels(eight_bit(np.asarray(array)), "rgb8")
