"""Streams of images that hang: the same picture again and again, while the robot goes on.

Sensors have noise, and so do the bytes of two pictures. Equal bytes for long are one picture sent
again. A simulated camera without noise that stands still gives them too, and nothing is said then.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgeval.recording.frame_reader import FrameReader, LostFrames
from dgeval.recording.pairing import Pair, Window
from dgeval.recording.roles import Roles
from dgeval.recording.scan import Scan

HANGS_S = 0.3  # s, for which a picture is the same; ours
MOVED_M = 0.01  # m, by which the camera moves meanwhile; ours
LEAST_SEEN = 0.01  # share of the pixels with depth, of a picture that shows something; ours
LEAST_CONTRAST = 2.0  # standard deviation of 8-bit colour; ours


def frozen_streams(scan: Scan, roles: Roles, window: Window, reader: FrameReader) -> list[str]:
    """What is wrong with the trial's images, a sentence for each role; none where they go on."""
    out = []
    robot = reader.robot
    digests = {
        "colour": [p.colour for p in window.pairs],
        "depth": [p.depth for p in window.pairs],
    }
    kept = {role: _digests(scan, getattr(roles, role), rows) for role, rows in digests.items()}
    stamps = np.array([p.t_ns for p in window.pairs], dtype=np.int64)
    for role, own in kept.items():
        other = kept["depth" if role == "colour" else "colour"]
        if own is None:
            continue
        first, last = _longest_run(own, stamps)
        lasts_s = (stamps[last] - stamps[first]) * 1e-9
        if lasts_s <= HANGS_S:
            continue
        goes_on = other is not None and len(set(other[first : last + 1].tolist())) > 1
        ends = [robot.T_base_camera(int(stamps[k])) for k in (first, last)]
        if ends[0] is not None and ends[1] is not None:
            goes_on |= bool(np.linalg.norm(ends[1][:3, 3] - ends[0][:3, 3]) > MOVED_M)
        if goes_on and not _is_blank(reader, window.pairs[first], role):
            at = (stamps[first] - stamps[0]) * 1e-9
            out.append(
                f"the {role} picture of {getattr(roles, role)} is the same for {lasts_s:.2f} s, "
                f"from {at:+.2f} s on, while the robot or the other picture goes on"
            )
    return out


def _is_blank(reader: FrameReader, pair: Pair, role: str) -> bool:
    """Whether a picture shows nothing, as depth of what is too near: such ones are all equal."""
    frame = next(replace(reader, pairs=(pair,), lost=LostFrames([])).frames(), None)
    if frame is None:
        return True
    if role == "depth":
        known = frame.depth[frame.depth > 0]
        # some drivers write one large value where there is no reading
        return len(known) < LEAST_SEEN * frame.depth.size or float(np.ptp(known)) == 0.0
    return float(frame.colour.std()) < LEAST_CONTRAST


def _digests(scan: Scan, topic: str | None, rows: list[int]) -> np.ndarray | None:
    """(n,) digests of a topic's messages by their numbers; None where they were not kept."""
    known = scan.times[topic].digests if topic in scan.times else []
    if not rows or len(known) <= max(rows):
        return None
    return np.array([known[k] for k in rows], dtype=np.int64)


def _longest_run(values: np.ndarray, stamps: np.ndarray) -> tuple[int, int]:
    """First and last index of the equal neighbours that last longest."""
    changes = np.flatnonzero(np.diff(values) != 0)
    first = np.concatenate([[0], changes + 1])
    last = np.concatenate([changes, [len(values) - 1]])
    k = int(np.argmax(stamps[last] - stamps[first]))
    return int(first[k]), int(last[k])
