"""A described hand as dgeval understands it: open and closed, from two sides, with its centre.

For a person to compare with the real one: fingers on the wrong link, meshes a hundred times too
large and a hand that closes outwards are seen at once.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, transform
from dgeval.robots.described_hand import DescribedHand
from dgeval.robots.hand_solids import surface_points

PANEL = 420  # px, of each of the four pictures
MARGIN, CAPTION = 40, 34  # px
BAR_M, ARROW_M = 0.05, 0.03  # m, of the scale's bar, and of the arrow of the approach
PALM, FINGER, EDGE = (196, 196, 200), (214, 170, 120), (90, 90, 90)  # BGR
CENTRE, TIP = (40, 40, 220), (60, 150, 60)
WHITE = (255, 255, 255)
# By column: the axes of the hand's base frame that point right and up in the picture.
VIEWS = (("y", "z", np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])),
         ("x", "z", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])))  # fmt: skip


def hand_picture(hand: DescribedHand) -> NDArray[np.uint8]:
    """BGR picture of four panels: open above, closed by the joints' limits below."""
    geometry = hand.geometry
    postures = (("open", geometry.open), ("closed to its limits", geometry.closed))
    everything = np.vstack([_outline(hand, q) for _, q in postures])
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = (PANEL - 2 * MARGIN) / float((high - low).max())
    rows = []
    for name, positions in postures:
        panels = []
        for right, up, axes in VIEWS:
            panel = _panel(hand, positions, axes, (low + high) / 2, scale)
            text = f"{name}; {right} to the right, {up} up"
            cv2.putText(panel, text, (10, 22), cv2.FONT_HERSHEY_DUPLEX, 0.45, EDGE, 1, cv2.LINE_AA)
            panels.append(panel)
        rows.append(np.hstack(panels))
    caption = np.full((CAPTION, 2 * PANEL, 3), 255, np.uint8)
    cv2.putText(
        caption, hand.told, (10, 22), cv2.FONT_HERSHEY_DUPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA
    )
    return np.vstack([caption, *rows])


def write_hand_picture(hand: DescribedHand, path: Path) -> None:
    """Write it as PNG. OSError where the file can't be written."""
    done, data = cv2.imencode(".png", hand_picture(hand))
    assert done
    path.write_bytes(data.tobytes())


def _outline(hand: DescribedHand, positions: Array) -> Array:
    """Points (n, 3) m on all solids, base frame."""
    shapes = hand.geometry.shapes(positions)
    return np.vstack([transform(T, surface_points(s, in_link=False)) for s, T in shapes])


def _panel(
    hand: DescribedHand, positions: Array, axes: Array, middle: Array, scale: float
) -> NDArray[np.uint8]:
    """One view. axes (2, 3): right and up. scale: px per m about the middle (3,)."""
    panel = np.full((PANEL, PANEL, 3), 255, np.uint8)

    def pixels(points: Array) -> NDArray[np.int32]:
        flat = (points - middle) @ axes.T * scale * [1.0, -1.0] + PANEL / 2
        return np.rint(flat).astype(np.int32)

    towards = np.cross(axes[0], axes[1])  # to the person who looks
    palm = set(hand.geometry.links.palm)
    shapes = hand.geometry.shapes(positions)
    for shape, T in sorted(shapes, key=lambda item: float(item[1][:3, 3] @ towards)):
        outline = cv2.convexHull(pixels(transform(T, surface_points(shape, in_link=False))))
        cv2.fillPoly(panel, [outline], PALM if shape.link in palm else FINGER)
        cv2.polylines(panel, [outline], True, EDGE, 1, cv2.LINE_AA)
    for tip in hand.geometry.tips_at(positions):
        cv2.circle(panel, pixels(tip[None])[0].tolist(), 4, TIP, -1, cv2.LINE_AA)
    at, ahead = pixels(np.array([hand.centre, hand.centre + ARROW_M * hand.approach])).tolist()
    cv2.arrowedLine(panel, at, ahead, CENTRE, 2, cv2.LINE_AA, tipLength=0.25)
    cv2.drawMarker(panel, at, CENTRE, cv2.MARKER_CROSS, 18, 2, cv2.LINE_AA)
    end = 10 + round(BAR_M * scale)
    cv2.line(panel, (10, PANEL - 12), (end, PANEL - 12), EDGE, 2)
    text = f"{BAR_M * 100:.0f} cm"
    place = (end + 6, PANEL - 8)
    cv2.putText(panel, text, place, cv2.FONT_HERSHEY_DUPLEX, 0.4, EDGE, 1, cv2.LINE_AA)
    return panel
