"""A synthetic recording with exact truth.

A printed box on a table under a moving camera, 640x480, 30 Hz, noisy depth.

python -m benchmarks.synthetic OUT.mcap --frames 99 --speed 0.1
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from datasets.raycast import Box, Scene, add_noise, printed, render, speckle
from dgeval.geometry import Array, Intrinsics, increment, pose_from_matrix
from dgeval.recording.write import (
    McapWriter,
    camera_info_message,
    jpeg_message,
    message,
    transform_message,
)

from benchmarks.motion import steps
from benchmarks.rebase import raw_depth_message

START_NS = 1_780_000_000_000_000_000
CAMERA = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
FRAME = "camera_color_optical_frame"
HALF = (0.08, 0.05, 0.035)  # m, a 16 x 10 x 7 cm box


@dataclass(frozen=True)
class Truth:
    """Per frame: T_world_camera, T_world_object, and the box x0 y0 x1 y1 px of visible pixels."""

    T_world_camera: list[Array]
    T_world_object: list[Array]
    boxes: list[tuple[float, float, float, float]]


def look_at(eye: Array, at: Array, roll: float) -> Array:
    """T_world_camera of a camera at `eye` that looks at `at`, (3,) m; roll rad about its axis."""
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = (
        np.stack([x, np.cross(z, x), z], axis=1)
        @ increment(np.array([0, 0, 0, 0, 0, roll]))[:3, :3]
    )
    T[:3, 3] = eye
    return T


def camera_pose(t: float, phase: Array, distance: float) -> Array:
    """T_world_camera at t s on a path round the origin, at most about 0.3 m/s and 0.4 rad/s."""
    azimuth = 0.3 + 0.5 * np.sin(0.8 * t + phase[0])
    elevation = 0.75 + 0.15 * np.sin(1.1 * t + phase[1])
    d = distance + 0.12 * np.sin(0.9 * t + phase[2])
    at = np.array([0.06 * np.sin(1.7 * t + phase[3]), 0.05 * np.sin(1.3 * t + phase[4]), 0.03])
    ray = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    return look_at(at + d * ray, at, 0.1 * np.sin(2 * t + phase[5]))


def write(
    out: Path, n: int = 99, speed: float = 0.0, seed: int = 1, distance: float = 0.75
) -> Truth:
    """Write the recording of n frames; returns its truth.

    speed: m/s, at which the box slides along y, stop and go (benchmarks.motion). distance: m, of
    the camera from the origin.
    """
    rng = np.random.default_rng(seed)
    table = speckle(rng, (150, 115, 80), 25)
    box = Box(HALF, [printed(rng, (170, 80, 60)) for _ in range(6)])
    block = Box((0.03, 0.03, 0.06), [speckle(rng, (90, 90, 160), 30)] * 6)
    T_block = increment(np.array([0.18, 0.1, 0.06, 0, 0, 0]))
    phase = rng.uniform(0, 6, 8)
    middle = speed * steps(n / 30) / 2
    truth = Truth([], [], [])
    with McapWriter(out) as writer:
        for k in range(n):
            t, t_ns = k / 30, START_NS + round(k / 30 * 1e9)
            T_object = increment(np.array([0, speed * steps(t) - middle, HALF[2], 0, 0, 0.6]))
            T_camera = camera_pose(t, phase, distance)
            colour, depth, ids = render(
                Scene(table, 1.2, [(box, T_object), (block, T_block)]), CAMERA, T_camera
            )
            v, u = np.nonzero(ids == 0)
            truth.boxes.append(
                (float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1))
            )
            truth.T_world_camera.append(T_camera)
            truth.T_world_object.append(T_object)
            colour, millimetres = add_noise(rng, colour, depth)
            moved = transform_message(t_ns, "world", FRAME, pose_from_matrix(T_camera))
            writer.write("/tf", t_ns, message("tf2_msgs/TFMessage", transforms=[moved]))
            writer.write(
                "/camera/color/camera_info", t_ns, camera_info_message(t_ns, FRAME, CAMERA)
            )
            writer.write(
                "/camera/color/image_raw/compressed", t_ns, jpeg_message(t_ns, FRAME, colour, 95)
            )
            depth_topic = "/camera/aligned_depth_to_color/image_raw"
            writer.write(depth_topic, t_ns, raw_depth_message(t_ns, FRAME, millimetres))
    return truth


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=99)
    parser.add_argument(
        "--speed", type=float, default=0.0, help="m/s, stop and go along the table's y"
    )
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    truth = write(args.out, args.frames, args.speed, args.seed)
    print(
        f"{args.out}: {args.frames} frames; box in the first: "
        f"{','.join(f'{v:.0f}' for v in truth.boxes[0])}"
    )


if __name__ == "__main__":
    main()
