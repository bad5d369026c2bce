"""How a recording's images become metres: the camera's intrinsics, depth scale and static mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import CalibrationConfig
from dgeval.errors import Place, UsageError
from dgeval.geometry import Intrinsics
from dgeval.recording.scan import Scan


@dataclass(frozen=True)
class Camera:
    """The colour camera, to which depth is aligned.

    depth_scale: m per unit of integer depth, None for the ROS convention. static_mask (H, W):
    depth is dropped where it is not 0; None without one. notes: what was assumed.
    """

    intrinsics: Intrinsics
    depth_scale: float | None
    static_mask: NDArray[np.uint8] | None
    notes: tuple[str, ...] = ()


def camera_of(
    scan: Scan, colour_topic: str, info_topic: str | None, config: CalibrationConfig
) -> Camera:
    """Configured intrinsics, else recorded ones. UsageError without either, or for a bad mask."""
    intrinsics, notes = _intrinsics(scan, colour_topic, info_topic, config)
    return Camera(intrinsics, config.depth_scale, _static_mask(config, intrinsics), tuple(notes))


def _intrinsics(
    scan: Scan, colour_topic: str, info_topic: str | None, config: CalibrationConfig
) -> tuple[Intrinsics, list[str]]:
    head = scan.images[colour_topic]
    if config.intrinsics is not None:
        return Intrinsics(head.width, head.height, *config.intrinsics), []
    model = scan.cameras.get(info_topic or "")
    if model is None:
        raise UsageError(
            "no camera intrinsics recorded",
            Place(str(scan.opened.path)),
            "give --set 'calibration.intrinsics=[fx, fy, cx, cy]'",
        )
    notes = []
    if any(abs(d) > 1e-9 for d in model.distortion):
        rounded = [round(d, 4) for d in model.distortion]
        notes.append(f"lens distortion {rounded} is recorded and not removed")
    if scan.camera_changes.get(info_topic or ""):
        notes.append("the intrinsics change within the recording; the first are used")
    return model.intrinsics, notes


def _static_mask(config: CalibrationConfig, camera: Intrinsics) -> NDArray[np.uint8] | None:
    if config.static_mask is None:
        return None
    mask = cv2.imread(config.static_mask, cv2.IMREAD_GRAYSCALE)
    if mask is None or mask.shape != (camera.height, camera.width):
        raise UsageError(
            f"calibration.static_mask is not an image of {camera.width}x{camera.height}",
            Place(config.static_mask),
        )
    return np.asarray(mask, dtype=np.uint8)
