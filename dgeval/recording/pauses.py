"""Trials of a recording that nobody cut: a recorder that was paused between them."""

from __future__ import annotations

from itertools import pairwise

from dgeval.recording.containers.container import Opened
from dgeval.recording.messages import IMAGE_TYPES, JOINT_TYPES, TF_TYPES

ROBOT_TYPES = TF_TYPES | JOINT_TYPES
PAUSE_NS = 3_000_000_000  # ns without a message on any topic: its recorder was paused; ours
LAST_NS = 2**63  # ns, later than any message
LEAST_ROBOT = 20  # messages of joints or transforms, for a robot that is recorded; ours
LEAST_IMAGES = 10  # between two pauses, for a trial; ours


def between_pauses(opened: Opened) -> list[tuple[int | None, int | None]]:
    """Begin and end, ns of the log, of each part between pauses that holds images; None for those
    of the recording.

    Images alone that stop while the robot is still recorded are lost, not paused. Empty for a
    recording that is damaged, or has no robot, since what it lost looks the same.
    """
    images = {name for name, topic in opened.topics.items() if topic.type in IMAGE_TYPES}
    robot = {name for name, topic in opened.topics.items() if topic.type in ROBOT_TYPES}
    times, n_robot = [], 0
    for message in opened.messages():
        times.append((message.log_ns, message.topic in images))
        n_robot += message.topic in robot
    if opened.damage or n_robot < LEAST_ROBOT:
        return []
    times.sort()
    held: list[tuple[int, int]] = []  # first and last log time
    first, n_images = times[0][0], 0
    for (t_ns, is_image), (next_ns, _) in zip(times, [*times[1:], (LAST_NS, False)], strict=True):
        n_images += is_image
        if next_ns - t_ns > PAUSE_NS:
            if n_images >= LEAST_IMAGES:
                held.append((first, t_ns))
            first, n_images = next_ns, 0
    middles = [(a[1] + b[0]) // 2 for a, b in pairwise(held)]
    return list(zip([None, *middles], [*middles, None], strict=True)) if held else []
