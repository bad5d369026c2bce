#!/bin/sh
# librealsense 2.59.1 (pyrealsense2 2.59.1.11053), recording to .db3.
#
# The header stamp of an image is when it arrived, counted from the start of the recording. The
# frame's own time, which earlier releases put into the header of a .bag, stands in the text of
# .../image/metadata that is logged at the same time. A reader that trusts header.stamp gets the
# delays of the USB bus as time, and a date in 1970.
#
# Seen: the k-th frame, given with the time 1700000000000 + 40 k ms, has
#   header.stamp in seconds below 2, and "timestamp=" with its own time in its metadata.
#
# Installs into a temporary folder; needs python3 3.11 and a package index. Exit code 0: as described.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m pip install -q --target "$folder/lib" --no-deps \
    pyrealsense2==2.59.1.11053 libusb-package==1.0.30.0
python3 -m pip install -q --target "$folder/lib" numpy==2.4.6 rosbags==0.11.0
mkdir "$folder/so"
ln -s "$folder/lib/libusb_package/libusb-1.0.so" "$folder/so/libusb-1.0.so.0"
cat > "$folder/try.py" <<'PY'
import sqlite3
import sys
import time

import numpy as np
import pyrealsense2 as rs
from rosbags.typesys import Stores, get_typestore

W, H, STEP_MS, START_MS = 64, 48, 40.0, 1.7e12
device = rs.software_device()
sensor = device.add_sensor("Depth")
stream = rs.video_stream()
stream.type, stream.index, stream.uid = rs.stream.depth, 0, 1
stream.width, stream.height, stream.fps, stream.bpp = W, H, 25, 2
stream.fmt = rs.format.z16
lens = rs.intrinsics()
lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = W, H, 60.0, 60.0, 31.5, 23.5
stream.intrinsics = lens
profile = sensor.add_video_stream(stream)
recorder = rs.recorder(sys.argv[1], device)
recorded = recorder.query_sensors()[0]
recorded.open(recorded.get_stream_profiles()[0])
recorded.start(lambda frame: None)
for k in range(6):
    frame = rs.software_video_frame()
    frame.pixels = np.full((H, W), 1000, np.uint16)
    frame.stride, frame.bpp, frame.frame_number = 2 * W, 2, k
    frame.timestamp, frame.domain = START_MS + STEP_MS * k, rs.timestamp_domain.global_time
    frame.profile = profile.as_video_stream_profile()
    sensor.on_video_frame(frame)
    time.sleep(0.02)
time.sleep(0.3)
recorded.stop()
recorded.close()
del recorder

store = get_typestore(Stores.ROS2_HUMBLE)
file = sqlite3.connect(sys.argv[1])
rows = "SELECT m.data FROM messages m JOIN topics t ON t.id = m.topic_id WHERE t.name LIKE ?"
heads = []
for (data,) in file.execute(rows, ("%/image/data/compressedDepth",)):
    stamp = store.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage").header.stamp
    heads.append(stamp.sec + stamp.nanosec * 1e-9)
texts = [
    store.deserialize_cdr(data, "std_msgs/msg/String").data
    for (data,) in file.execute(rows, ("%/image/metadata",))
]
print("header stamps, s:", [round(h, 3) for h in heads])
print("metadata:", texts[0])
assert len(heads) == len(texts) == 6
assert all(h < 2 for h in heads), heads
for k, text in enumerate(texts):
    assert f"timestamp={START_MS + STEP_MS * k:.6f}" in text, text
print("as described")
PY
LD_LIBRARY_PATH="$folder/so" PYTHONPATH="$folder/lib" python3 "$folder/try.py" "$folder/made.db3"
