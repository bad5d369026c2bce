"""VFAS-Grasp's motion field: optical flow lifted with depth, averaged near the grasp.

The camera's own motion is taken out. The flow is GMFlow's where its weights are given, which are
not shipped; else OpenCV's DIS stands in.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics, transform

Image = NDArray[np.uint8]  # (h, w, 3) RGB
# two images of one size -> displacement (h, w, 2) px of the first one's pixels
Flow = Callable[[Image, Image], NDArray[np.float32]]
MOST = 4000  # pixels that are lifted, about
LEAST = 10  # points; with fewer there is no velocity
# share left out at each end, along each axis: flow across an edge ends on another surface
TRIM = 0.2


def dis_flow() -> Flow:
    """Dense inverse search (Kroeger, ECCV 2016), OpenCV's medium preset."""
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)

    def flow(before: Image, now: Image) -> NDArray[np.float32]:
        first, second = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (before, now))
        return np.asarray(method.calc(first, second, None), dtype=np.float32)

    return flow


def gmflow(weights: Path) -> Flow:
    """GMFlow with a file's weights. A frame's features are made once, for both of its pairs.

    Raises UsageError if the weights can't be read or don't fit.
    """
    from dgeval.networks.gmflow import load_gmflow  # imports torch

    network = load_gmflow(weights)
    last: tuple[Image, tuple[Any, ...]] | None = None

    def flow(before: Image, now: Image) -> NDArray[np.float32]:
        nonlocal last
        is_kept = last is not None and last[0] is before
        first = last[1] if last is not None and is_kept else network.features(before)
        second = network.features(now)
        last = (now, second)
        return network.match(first, second, *before.shape[:2])

    return flow


class MotionField:
    """Mean velocity of the scene near a point, from every two successive frames."""

    def __init__(self, flow: Flow) -> None:
        self._flow = flow
        self._previous: tuple[int, Image, NDArray[np.float32], Array] | None = None

    def step(
        self,
        t_ns: int,
        colour: NDArray[np.uint8],
        depth: NDArray[np.float32],
        camera: Intrinsics,
        T_base_camera: Array,
        centre: Array,
        radius: float,
    ) -> Array | None:
        """Velocity (3,) m/s, base frame, of what is within radius m of centre (3,) m, base frame.

        None for the first frame and with too few points. colour (h, w, 3) RGB, depth (h, w) m, 0
        for none. Both ends of the flow are lifted with their own frame's depth and camera pose, so
        that a moving wrist does not look like a moving object (docs/papers.md, "Lifting the flow").
        """
        previous, self._previous = self._previous, (t_ns, colour, depth, T_base_camera)
        if previous is None or t_ns <= previous[0]:
            return None
        previous_ns, previous_colour, previous_depth, T_base_previous = previous
        v, u = np.nonzero(previous_depth > 0)
        step = max(1, len(u) // (4 * MOST))
        v, u = v[::step], u[::step]
        start = transform(
            T_base_previous, camera.backproject(u, v, previous_depth[v, u].astype(float))
        )
        near = np.flatnonzero(((start - centre) ** 2).sum(axis=1) < radius**2)
        if len(near) < LEAST:
            return None
        near = near[:: max(1, len(near) // MOST)]
        u, v, start = u[near], v[near], start[near]
        moved = self._flow(previous_colour, colour)[v, u]
        to_u, to_v = u + moved[:, 0], v + moved[:, 1]
        iu, iv = np.rint(to_u).astype(int), np.rint(to_v).astype(int)
        inside = (iu >= 0) & (iv >= 0) & (iu < camera.width) & (iv < camera.height)
        z = np.zeros(len(iu))
        z[inside] = depth[iv[inside], iu[inside]]
        # a point that moves by more than the radius between two frames was lifted onto another
        # surface
        end = transform(T_base_camera, camera.backproject(to_u, to_v, z))
        displacement = end - start
        good = (z > 0) & (np.linalg.norm(displacement, axis=1) < radius)
        if good.sum() < LEAST:
            return None
        ordered = np.sort(displacement[good], axis=0)
        cut = int(TRIM * len(ordered))
        return np.asarray(
            ordered[cut : len(ordered) - cut].mean(axis=0) / ((t_ns - previous_ns) * 1e-9)
        )
