"""Moving objects in real images: a recording with other camera poses, M(t) · T_base_camera(t).

What stood still in the base frame then moves in it exactly as M(t), and every image stays as it was
recorded. The variant holds colour, depth, intrinsics, /tf from base to camera, and /camera_pose if
the source has it; nothing else of the source. With --passes 2 or 3 the frames run forward,
backward, forward at the median frame period, so that a short recording gives a longer trial; the
camera path stays continuous. --colour-camera is for a source whose depth is not registered to
colour: depth is then resampled into the colour camera, and only colour stays as it was recorded.

    python -m benchmarks.rebase SOURCE OUT.mcap --mode 200mm/s --frames 72:96 --passes 3
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.config import Config
from dgeval.geometry import Array, pose_from_matrix
from dgeval.recording.images import decode_image, depth_from
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.trials import Trial, open_trial
from dgeval.recording.write import (
    TYPES,
    McapWriter,
    camera_info_message,
    header,
    message,
    pose_message,
    transform_message,
)

from benchmarks.depth_to_colour import ColourCamera
from benchmarks.motion import MODES, Motion


@dataclass(frozen=True)
class Written:
    """Truth of a variant, per written frame.

    t_ns: stamp. seconds: since the source's first frame. M: M(t). T_source: T_base_camera of the
    source. source_frame: index in the source.
    """

    t_ns: list[int]
    seconds: Array
    M: list[Array]
    T_source: list[Array | None]
    source_frame: list[int]
    motion: Motion


def rebase(
    trial: Trial,
    out: Path,
    motion: Motion,
    passes: int = 1,
    drop: tuple[float, float] | None = None,
    with_pose: bool = True,
    colour_camera: ColourCamera | None = None,
) -> Written:
    """Write the variant of one trial; frames from drop[0] s on, for drop[1] s, are left out."""
    images = _images(trial)
    order = _order(len(images), passes)
    stamps = [images[k][0] for k in range(len(images))]
    period = int(np.median(np.diff(stamps))) if len(stamps) > 1 else 33_333_333
    base, camera = trial.robot.base_frame or "base", trial.robot.camera_frame
    has_topic = "/camera_pose" in trial.opened.topics
    assert trial.roles.colour is not None
    assert trial.roles.depth is not None
    written: list[tuple[int, Array, Array | None, int]] = []
    with McapWriter(out) as writer:
        for position, k in enumerate(order):
            t_ns = stamps[k] if passes == 1 else stamps[0] + position * period
            t = (t_ns - stamps[0]) * 1e-9
            M, T = motion.at(t), trial.robot.T_base_camera(stamps[k])
            if T is not None and colour_camera is not None:
                T = T @ colour_camera.T_depth_colour()
            if with_pose and T is not None:
                pose = pose_from_matrix(M @ T)
                moved = transform_message(t_ns, base, camera, pose)
                writer.write("/tf", t_ns, message("tf2_msgs/TFMessage", transforms=[moved]))
                if has_topic:
                    stamped = message(
                        "geometry_msgs/PoseStamped",
                        header=header(t_ns, base),
                        pose=pose_message(pose),
                    )
                    writer.write("/camera_pose", t_ns, stamped)
            if drop is not None and drop[0] <= t < drop[0] + drop[1]:
                continue
            colour, depth = images[k][1:]
            intrinsics = colour_camera.intrinsics(trial.camera) if colour_camera else trial.camera
            writer.write(
                "/camera/color/camera_info", t_ns, camera_info_message(t_ns, camera, intrinsics)
            )
            writer.write(trial.roles.colour, t_ns, _restamped(colour, t_ns))
            if colour_camera is None:
                writer.write(trial.roles.depth, t_ns, _restamped(depth, t_ns))
            else:
                metres = depth_from(decode_image(depth), trial.config.calibration.depth_scale)
                moved_depth = raw_depth_message(
                    t_ns, camera, colour_camera.register(metres, trial.camera)
                )
                writer.write("/camera/depth_in_colour/image_raw", t_ns, moved_depth)
            written.append((t_ns, M, T, k))
    t_list = [w[0] for w in written]
    seconds = (np.array(t_list) - stamps[0]) * 1e-9
    return Written(
        t_list,
        seconds,
        [w[1] for w in written],
        [w[2] for w in written],
        [w[3] for w in written],
        motion,
    )


def _images(trial: Trial) -> list[tuple[int, Any, Any]]:
    """(stamp ns, colour message, depth message) of every paired frame, all in memory."""
    topics = {trial.roles.colour: 1, trial.roles.depth: 2}
    pair_of = {(role, pair[role]): k for k, pair in enumerate(trial.pairs) for role in (1, 2)}
    out: list[list[Any]] = [[pair[0], None, None] for pair in trial.pairs]
    count = {1: -1, 2: -1}
    for raw in trial.opened.messages(frozenset(t for t in topics if t)):
        role = topics[raw.topic]
        count[role] += 1
        pair_index = pair_of.get((role, count[role]))
        if pair_index is not None:
            out[pair_index][role] = trial.opened.decode(raw)
    return [(t, colour, depth) for t, colour, depth in out]


def raw_depth_message(t_ns: int, frame_id: str, millimetres: Any) -> Any:
    """Depth (H, W) mm as sensor_msgs/Image 16UC1. (A PNG of noisy depth takes 1 s per frame.)"""
    height, width = millimetres.shape
    data = np.ascontiguousarray(millimetres, dtype="<u2").view(np.uint8).ravel()
    return message(
        "sensor_msgs/Image",
        header=header(t_ns, frame_id),
        height=height,
        width=width,
        encoding="16UC1",
        is_bigendian=0,
        step=2 * width,
        data=data,
    )


def _restamped(value: Any, t_ns: int) -> Any:
    """The image message as ROS 2 with another stamp; its pixels are unchanged."""
    kind: Any = TYPES[value.__msgtype__]
    names = [f.name for f in fields(kind) if f.name not in ("header", "__msgtype__")]
    return kind(header=header(t_ns, value.header.frame_id), **{n: getattr(value, n) for n in names})


def _order(n: int, passes: int) -> list[int]:
    """Frame indices forward, backward, forward, …; the turning frame is not repeated."""
    out = list(range(n))
    for k in range(1, passes):
        out += list(range(n - 2, -1, -1)) if k % 2 else list(range(1, n))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", type=Path, help="a recording that dgeval reads")
    parser.add_argument("out", type=Path, help="MCAP file to write")
    parser.add_argument("--mode", choices=sorted(MODES), default="200mm/s")
    parser.add_argument("--direction", default="1,0,0", help="unit vector, base axes")
    parser.add_argument(
        "--pivot", default="0,0,0", help="m, base frame: the point slow-yaw turns about"
    )
    parser.add_argument("--frames", help="A:B, paired frames of the source")
    parser.add_argument("--passes", type=int, default=1, help="forward, backward, forward, …")
    parser.add_argument("--drop-from", type=float, help="s after the first frame")
    parser.add_argument("--drop-for", type=float, default=0.5, help="s")
    parser.add_argument("--no-pose", action="store_true", help="leave the camera poses out")
    parser.add_argument(
        "--colour-camera",
        help="focal px, baseline m of an unregistered colour camera, e.g. 525,0.025",
    )
    args = parser.parse_args()
    frames = tuple(int(v) for v in args.frames.split(":")) if args.frames else None
    trial = open_trial(TrialSpec("source", args.source, frames=frames), Config())  # type: ignore[arg-type]
    triple = [tuple(float(v) for v in text.split(",")) for text in (args.direction, args.pivot)]
    motion = Motion(args.mode, *triple)  # type: ignore[arg-type]
    drop = (args.drop_from, args.drop_for) if args.drop_from is not None else None
    colour_camera = (
        ColourCamera(*(float(v) for v in args.colour_camera.split(",")))
        if args.colour_camera
        else None
    )
    written = rebase(trial, args.out, motion, args.passes, drop, not args.no_pose, colour_camera)
    print(f"{args.out}: {len(written.t_ns)} frames over {written.seconds[-1]:.2f} s, {args.mode}")


if __name__ == "__main__":
    main()
