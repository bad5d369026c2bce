#!/bin/sh
# librealsense 2.57.7 (pyrealsense2 2.57.7.10387), recording to .bag.
#
# An image's frame_id is the number of its group of streams: the same for colour and depth, also
# where the two cameras stand apart and are turned against each other. A reader that takes one frame
# and one size for aligned depth lays depth on the wrong pixels. Where the cameras are stands in
# .../tf/N (geometry_msgs/Transform), N the group: it maps points of the group's reference into the
# stream, p_stream = T p_reference, which is the inverse of what tf2 calls the stream's transform.
#
# Seen: depth is the reference, colour is 15 mm beside it and turned by 0.3 rad about its axis: both
# images are in the frame "1", depth's transform is the identity, and colour's is that which
# rs2_transform_point_to_point applies from depth to colour.
#
# Installs into a temporary folder; needs python3 3.11 and a package index. Exit code 0: as described.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m pip install -q --target "$folder/lib" --no-deps \
    pyrealsense2==2.57.7.10387 libusb-package==1.0.30.0
python3 -m pip install -q --target "$folder/lib" numpy==2.4.6 rosbags==0.11.0
mkdir "$folder/so"
ln -s "$folder/lib/libusb_package/libusb-1.0.so" "$folder/so/libusb-1.0.so.0"
cat > "$folder/write.py" <<'PY'
import gc
import math
import sys
import time

import numpy as np
import pyrealsense2 as rs

W, H, TURN = 64, 48, 0.3
device = rs.software_device()
profiles = []
for uid, (name, kind, pixel, form) in enumerate(
    (("Depth", rs.stream.depth, 2, rs.format.z16), ("Color", rs.stream.color, 3, rs.format.rgb8)), 1
):
    sensor = device.add_sensor(name)
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fmt = kind, 0, uid, form
    stream.width, stream.height, stream.fps, stream.bpp = W, H, 30, pixel
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = W, H, 60.0, 60.0, 31.5, 23.5
    stream.intrinsics = lens
    profiles.append((sensor, sensor.add_video_stream(stream), pixel))
c, s = math.cos(TURN), math.sin(TURN)
mount = rs.extrinsics()
mount.rotation, mount.translation = [c, s, 0, -s, c, 0, 0, 0, 1], [0.015, 0.0, 0.0]  # by columns
depth, colour = profiles[0][1], profiles[1][1]
depth.register_extrinsics_to(colour, mount)
there = rs.rs2_transform_point_to_point(depth.get_extrinsics_to(colour), [0.1, 0.2, 1.0])
print(*there)
recorder = rs.recorder(sys.argv[1], device)
recorded = list(recorder.query_sensors())
for one in recorded:
    one.open(one.get_stream_profiles()[0])
    one.start(lambda frame: None)
for k in range(4):
    for sensor, profile, pixel in profiles:
        frame = rs.software_video_frame()
        shape, kind = ((H, W), np.uint16) if pixel == 2 else ((H, W, 3), np.uint8)
        frame.pixels = np.full(shape, 100, kind)
        frame.stride, frame.bpp, frame.frame_number = pixel * W, pixel, k
        frame.timestamp, frame.domain = 1.7e12 + 33.0 * k, rs.timestamp_domain.global_time
        frame.profile = profile.as_video_stream_profile()
        sensor.on_video_frame(frame)
    time.sleep(0.03)
time.sleep(0.3)
for one in recorded:
    one.stop()
    one.close()
del one, recorded
gc.collect()
del recorder
gc.collect()
PY
cat > "$folder/read.py" <<'PY'
import sys
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

there = np.array(sys.argv[2:5], dtype=float)
frames, poses = {}, {}
with AnyReader([Path(sys.argv[1])]) as reader:
    for connection, _, data in reader.messages():
        stream, _, rest = connection.topic.partition("/sensor_")[2].partition("/")[2].partition("/")
        if rest == "image/data":
            # behind the header's stamp, of 12 bytes, stands the name's length
            length = int.from_bytes(data[12:16], "little")
            frames.setdefault(stream, set()).add(bytes(data[16 : 16 + length]).decode())
        elif rest.startswith("tf/"):
            pose = reader.deserialize(data, connection.msgtype)
            t, q = pose.translation, pose.rotation
            x, y, z, w = q.x, q.y, q.z, q.w
            R = np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ])
            poses[stream] = R, np.array([t.x, t.y, t.z])
print("frames:", frames)
assert frames == {"Depth_0": {"1"}, "Color_0": {"1"}}, frames
R, t = poses["Depth_0"]
assert np.allclose(R, np.eye(3), atol=1e-6) and np.allclose(t, 0, atol=1e-6), poses
R, t = poses["Color_0"]
print("in colour, by the file:", R @ [0.1, 0.2, 1.0] + t, "by librealsense:", there)
assert np.allclose(R @ [0.1, 0.2, 1.0] + t, there, atol=1e-5)
print("as described")
PY
there=$(LD_LIBRARY_PATH="$folder/so" PYTHONPATH="$folder/lib" \
    python3 "$folder/write.py" "$folder/made.bag" | tail -1)
# shellcheck disable=SC2086
PYTHONPATH="$folder/lib" python3 "$folder/read.py" "$folder/made.bag" $there
