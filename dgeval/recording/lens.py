"""Lens distortion, taken out of the pictures so that every stage sees a pinhole camera.

Colour and depth are drawn anew where an ideal camera with the same matrix would have them; depth
by the nearest reading, so that no depth between two surfaces is made up. Distortion that moves
nothing by more than half a pixel stays: drawing anew would cost more than it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Intrinsics
from dgeval.recording.messages import CameraModel

LEAST_PX = 0.5  # px, that distortion moves a pixel by at least, to be taken out
# distortion_model of sensor_msgs/CameraInfo -> how many coefficients it may have
POLYNOMIAL = {
    "plumb_bob": (4, 5),
    "brown conrady": (5,),
    "rational_polynomial": (8, 12, 14),
    "": (4, 5, 8, 12, 14),
}
FISHEYE = {"equidistant": (4,), "fisheye": (4,), "kannala_brandt": (4,)}
RADII = 400  # at which the lens is tried for folding back

Map = NDArray[np.float32]


@dataclass(frozen=True)
class Lens:
    """Where the pixels of the straightened picture stand in the recorded one.

    u, v: (H, W) px, -1 where the lens shows nothing. most_px: how far a pixel moves at most.
    """

    matrix: Intrinsics
    coefficients: tuple[float, ...]
    is_fisheye: bool
    most_px: float
    u: Map = field(compare=False, repr=False)
    v: Map = field(compare=False, repr=False)

    def colour(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(H, W, 3) straightened, black where nothing is seen. ValueError for another size."""
        return np.asarray(self._drawn(picture, cv2.INTER_LINEAR), dtype=np.uint8)

    def depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W) m straightened, 0 where nothing is seen. ValueError for another size."""
        return np.asarray(self._drawn(depth, cv2.INTER_NEAREST), dtype=np.float32)

    def mask(self, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(H, W) straightened."""
        return np.asarray(self._drawn(mask, cv2.INTER_NEAREST), dtype=np.uint8)

    def box(self, box: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        """A box of the recorded picture, x0 y0 x1 y1 px, in the straightened one."""
        x0, y0, x1, y1 = box
        edge = np.array([[x, y] for x in (x0, (x0 + x1) / 2, x1) for y in (y0, (y0 + y1) / 2, y1)])
        m = self.matrix
        K = np.array([[m.fx, 0, m.cx], [0, m.fy, m.cy], [0, 0, 1.0]])
        D = np.array(self.coefficients)
        points = edge[:, None, :]
        if self.is_fisheye:
            straight = cv2.fisheye.undistortPoints(points, K, D, P=K)
        else:
            straight = cv2.undistortPoints(points, K, D, P=K)
        low, high = straight[:, 0].min(axis=0), straight[:, 0].max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def _drawn(self, picture: NDArray[np.generic], how: int) -> NDArray[np.generic]:
        if picture.shape[:2] != self.u.shape:
            height, width = self.u.shape
            raise ValueError(
                f"a picture of {picture.shape[1]}x{picture.shape[0]}, the lens is known for "
                f"{width}x{height}"
            )
        return np.asarray(
            cv2.remap(picture, self.u, self.v, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        )


def lens_of(model: CameraModel, matrix: Intrinsics) -> tuple[Lens | None, str]:
    """The lens of a picture that is not rectified, and a note; None and "" where it does nothing.

    A model that is not known is noted, not guessed.
    """
    given = model.distortion
    if not any(abs(d) > 1e-12 for d in given):
        return None, ""
    name = model.lens_model.lower()
    is_fisheye = name in FISHEYE
    if len(given) not in {**POLYNOMIAL, **FISHEYE}.get(name, ()) or not np.isfinite(given).all():
        rounded = [round(d, 4) for d in given]
        return None, f"lens distortion {rounded} ({name or 'no model named'}) is not removed"
    u, v = np.meshgrid(np.arange(matrix.width), np.arange(matrix.height))
    x, y = (u - matrix.cx) / matrix.fx, (v - matrix.cy) / matrix.fy
    seen = np.hypot(x, y) < _folds_at(given, is_fisheye, float(np.hypot(x, y).max()))
    bent = _bent(np.column_stack([x.ravel(), y.ravel()]), given, is_fisheye)
    map_u = bent[:, 0].reshape(u.shape) * matrix.fx + matrix.cx
    map_v = bent[:, 1].reshape(u.shape) * matrix.fy + matrix.cy
    most = float(np.hypot(map_u - u, map_v - v)[seen].max(initial=0.0))
    if most < LEAST_PX:
        return None, ""
    map_u[~seen] = map_v[~seen] = -1.0
    lens = Lens(matrix, given, is_fisheye, most, map_u.astype(np.float32), map_v.astype(np.float32))
    return lens, f"lens distortion of up to {most:.1f} px is taken out of the pictures"


def _bent(points: NDArray[np.float64], given: tuple[float, ...], is_fisheye: bool) -> Map:
    """Normalised image points (n, 2) as the lens shows them."""
    D = np.array(given)
    if is_fisheye:
        return np.asarray(cv2.fisheye.distortPoints(points[:, None], np.eye(3), D))[:, 0]
    rays = np.column_stack([points, np.ones(len(points))])
    return np.asarray(cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), D)[0])[:, 0]


def _folds_at(given: tuple[float, ...], is_fisheye: bool, farthest: float) -> float:
    """Radius, normalised, from which on the formula brings points back towards the middle."""
    radii = np.linspace(0.0, farthest * 1.001, RADII)
    bent = _bent(np.column_stack([radii, np.zeros(RADII)]), given, is_fisheye)[:, 0]
    falling = np.flatnonzero(np.diff(bent) <= 0)
    return float(radii[falling[0]]) if len(falling) else np.inf
