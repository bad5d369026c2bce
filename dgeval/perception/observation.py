"""P_t: the target's pixels as points, without those far from the median depth.

See docs/papers.md, "Depth filter".
"""

from __future__ import annotations

import numpy as np

from dgeval.config import ObservationConfig
from dgeval.perception import segmentation
from dgeval.perception.types import Observation, Tracked
from dgeval.recording.frame import Frame


def observe(
    frame: Frame, tracked: Tracked, rng: np.random.Generator, config: ObservationConfig
) -> Observation | None:
    """Points of the mask with normals; at most `max_points`, None below `min_points`."""
    if tracked.mask is None or tracked.window is None:
        return None
    x0, y0, x1, y1 = tracked.window
    depth = frame.depth[y0:y1, x0:x1]
    v, u = np.nonzero(tracked.mask)
    z = depth[v, u]
    if not len(z):
        return None
    near = np.abs(z - np.median(z)) <= config.c_z
    v, u = v[near], u[near]
    if len(v) < config.min_points:
        return None
    if len(v) > config.max_points:
        # one pixel at random of each of max_points equal parts of the row-ordered list, so that the
        # pixels cover the mask evenly
        edges = np.linspace(0, len(v), config.max_points + 1)
        chosen = (edges[:-1] + rng.random(config.max_points) * np.diff(edges)).astype(int)
        v, u = v[chosen], u[chosen]
    points = frame.camera.backproject(u + float(x0), v + float(y0), depth[v, u].astype(np.float64))
    smooth = segmentation.smoothed(depth, tracked.mask)
    return Observation(points, segmentation.normals_at(smooth, tracked.window, v, u, frame.camera))
