"""What reading a recording costs against the libraries alone: `python -m benchmarks.reading FILE…`.

Bare: one pass of mcap's own reader, each message deserialised by rosbags, each picture decoded by
OpenCV. dgeval: opening the trial (roles, clocks, transforms, checks) and all its frames. The two
alternate; the ratio of the medians counts. Memory: the peak over a recording and over the same one
repeated twenty times.

    python -m benchmarks.reading datasets/demo.mcap
    python -m benchmarks.reading --memory datasets/demo.mcap
    python -m benchmarks.reading --memory --colour video datasets/demo.mcap
    python -m benchmarks.reading --memory --colour protobuf datasets/demo.mcap
    python -m benchmarks.reading --alignment
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from dgeval.config import Config
from dgeval.determinism import limit_threads
from dgeval.geometry import Intrinsics, increment
from dgeval.recording.alignment import Alignment
from dgeval.recording.containers.opening import open_container
from dgeval.recording.manifest import find_trials
from dgeval.recording.scan import scan
from dgeval.recording.trials import Trial, open_trial
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore
from tests.soak.mutated_messages import raw_image_type

STORE = get_typestore(Stores.ROS2_HUMBLE)
PNG = b"\x89PNG"


def bare(path: Path) -> int:
    """Pictures decoded."""
    count = 0
    with path.open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages():
            if schema is None or schema.name not in STORE.fielddefs:
                continue
            value = STORE.deserialize_cdr(message.data, schema.name)
            if schema.name == "sensor_msgs/msg/CompressedImage":
                data = np.asarray(value.data, np.uint8)
                start = max(bytes(data[:64]).find(PNG), 0)
                count += cv2.imdecode(data[start:], cv2.IMREAD_UNCHANGED) is not None
    return count


def ours(path: Path) -> int:
    """Frames."""
    trial = open_trial(find_trials([path])[0], Config())
    return sum(1 for _ in trial.frames())


def passes(path: Path) -> int:
    """The two passes over the file alone: the scan, and the frames of a trial that is open."""
    scan(open_container(path))
    return sum(1 for _ in trial_of(path).frames())


@cache
def trial_of(path: Path) -> Trial:
    return open_trial(find_trials([path])[0], Config())


def seconds(run: Callable[[Path], int], path: Path) -> float:
    start = time.process_time()
    run(path)
    return time.process_time() - start


def repeated(path: Path, out: Path, times: int) -> None:
    """The recording `times` over, one after the other, its events once."""
    with path.open("rb") as stream, out.open("wb") as written:
        listed = list(make_reader(stream).iter_messages())
        writer = Writer(written)
        writer.start(profile="ros2", library="benchmark")
        first, last = listed[0][2].log_time, listed[-1][2].log_time
        channels: dict[str, int] = {}
        for k in range(times):
            shift = k * (last - first + 50_000_000)
            for schema, channel, message in listed:
                if schema is None or (k and channel.topic == "/dgeval/events"):
                    continue
                if channel.topic not in channels:
                    made = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.topic] = writer.register_channel(channel.topic, "cdr", made)
                data = bytearray(message.data)
                if schema.name.endswith(("Image", "CameraInfo", "JointState", "PoseStamped")):
                    t = int.from_bytes(data[4:8], "little") * 10**9
                    t += int.from_bytes(data[8:12], "little") + shift
                    data[4:8] = (t // 10**9).to_bytes(4, "little")
                    data[8:12] = (t % 10**9).to_bytes(4, "little")
                writer.add_message(
                    channels[channel.topic], message.log_time + shift, bytes(data),
                    message.log_time + shift,
                )  # fmt: skip
        writer.finish()


def with_colour(path: Path, out: Path, how: str) -> Path:
    """The recording with its colour as H.264, or as foxglove.RawImage in protobuf."""
    kind = "sensor_msgs/msg/CompressedImage"
    made, schema = raw_image_type()
    context: Any = None
    with path.open("rb") as stream, out.open("wb") as written:
        writer = Writer(written)
        writer.start(profile="ros2", library="benchmark")
        channels: dict[str, int] = {}
        for old, channel, message in make_reader(stream).iter_messages():
            if old is None:
                continue
            is_colour = channel.topic.endswith("color/image_raw/compressed")
            data, encoding, name = message.data, channel.message_encoding, old.name
            text, of = old.data, old.encoding
            if is_colour:
                value = STORE.deserialize_cdr(data, kind)
                pixels = cv2.imdecode(np.asarray(value.data, np.uint8), cv2.IMREAD_COLOR)
                stamp = value.header.stamp
                if how == "protobuf":
                    image = made(
                        frame_id=value.header.frame_id, width=pixels.shape[1],
                        height=pixels.shape[0], encoding="bgr8", step=3 * pixels.shape[1],
                        data=pixels.tobytes(),
                    )  # fmt: skip
                    image.timestamp.seconds, image.timestamp.nanos = stamp.sec, stamp.nanosec
                    data, encoding = image.SerializeToString(), "protobuf"
                    name, text, of = "foxglove.RawImage", schema, "protobuf"
                else:
                    if context is None:
                        context = av.CodecContext.create("libx264", "w")
                        context.width, context.height = pixels.shape[1], pixels.shape[0]
                        context.pix_fmt, context.time_base = "yuv420p", Fraction(1, 30)
                        context.options = {"tune": "zerolatency", "preset": "ultrafast"}
                    frame = av.VideoFrame.from_ndarray(pixels, format="bgr24")
                    packet = b"".join(bytes(p) for p in context.encode(frame))
                    value.format, value.data = "h264", np.frombuffer(packet, np.uint8)
                    data = bytes(STORE.serialize_cdr(value, kind))
            if channel.topic not in channels:
                register = writer.register_schema(name, of, text)
                channels[channel.topic] = writer.register_channel(channel.topic, encoding, register)
            at = message.log_time
            writer.add_message(channels[channel.topic], at, data, at)
        writer.finish()
    return out


def peak_mb(path: Path) -> float:
    """Peak memory of a fresh process that reads the whole file, MB."""
    code = (
        "import resource,sys; from pathlib import Path; from benchmarks.reading import ours_whole; "
        "ours_whole(Path(sys.argv[1])); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def ours_whole(path: Path) -> int:
    """Frames of the whole file, whatever its events cut out."""
    spec = find_trials([path])[0]
    trial = open_trial(replace(spec, start_ns=None, end_ns=None), Config())
    return sum(1 for _ in trial.frames())


def alignment(rounds: int = 15) -> str:
    """What bringing depth (848x480) into colour (1280x720) costs: against decoding that depth, and
    against points drawn with numpy, which leaves cracks.
    """
    depth_camera = Intrinsics(848, 480, 425.0, 425.0, 423.5, 239.5)
    colour_camera = Intrinsics(1280, 720, 915.0, 915.0, 639.5, 359.5)
    T = increment(np.array([0.015, 0.0, 0.0, 0.01, -0.02, 0.01]))
    v, u = np.mgrid[0:480, 0:848]
    depth = (0.6 + 0.2 * np.sin(u / 90) * np.cos(v / 70)).astype(np.float32)
    png = cv2.imencode(".png", np.rint(depth * 1000).astype(np.uint16))[1]
    aligner = Alignment(depth_camera, colour_camera, T)

    def points() -> None:
        at = depth_camera.backproject(u.ravel(), v.ravel(), depth.ravel().astype(float))
        there = at @ T[:3, :3].T + T[:3, 3]
        x, y = np.rint(colour_camera.project(there)).astype(int).T
        inside = (x >= 0) & (x < 1280) & (y >= 0) & (y < 720)
        out = np.full((720, 1280), np.inf)
        np.minimum.at(out, (y[inside], x[inside]), there[inside, 2])

    runs = {
        "aligned": lambda: aligner.apply(depth),
        "decoded": lambda: cv2.imdecode(png, cv2.IMREAD_UNCHANGED),
        "points": points,
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    for k in range(rounds + 1):
        for name, run in runs.items():
            start = time.process_time()
            run()
            if k:  # the first compiles
                times[name].append(time.process_time() - start)
    aligned, decoded, drawn = (statistics.median(times[name]) for name in runs)
    return (
        f"alignment: {aligned / decoded:.2f} times the decoding of the depth, "
        f"{aligned / drawn:.2f} times points drawn with numpy"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--alignment", action="store_true")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--colour", choices=["video", "protobuf"], help="write colour so first")
    args = parser.parse_args()
    limit_threads()
    if args.alignment:
        print(alignment())
    for path in args.files:
        if args.memory:
            with tempfile.TemporaryDirectory() as folder:
                long = Path(folder) / "long.mcap"
                repeated(path, long, 20)
                if args.colour:
                    long = with_colour(long, Path(folder) / "long2.mcap", args.colour)
                    path = with_colour(path, Path(folder) / path.name, args.colour)
                print(
                    f"{path.name}: {peak_mb(path):.0f} MB, 20 times as long {peak_mb(long):.0f} MB"
                )
            continue
        ours(path)
        passes(path)
        rounds = [[seconds(run, path) for run in (bare, passes, ours)] for _ in range(args.rounds)]
        b, p, o = (statistics.median(r[k] for r in rounds) for k in range(3))
        print(
            f"{path.name}: CPU time bare {b:.3f} s; both passes {p:.3f} s, ratio {p / b:.2f}; "
            f"opening with all checks, and frames {o:.3f} s, ratio {o / b:.2f}"
        )


if __name__ == "__main__":
    main()
