#!/bin/sh
# rosbags 0.11.9, reading a ROS 2 .db3 that has a write-ahead log beside it.
#
# rosbag2's crash-safe preset records SQLite in WAL mode. Where the recorder is killed, messages
# stay in NAME.db3-wal until something opens the file for writing. rosbags opens it with
# immutable=1, with which SQLite does not look at the log: the messages in it are missing, and
# nothing says so.
#
# Seen: of 20 messages, 8 of them in the log, rosbags gives 12 and sqlite3 20.
#
# Installs into a temporary folder; needs python3 3.11 and a package index. Exit code 0: as described.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m pip install -q --target "$folder/lib" rosbags==0.11.9 numpy==2.4.6
cat > "$folder/try.py" <<'PY'
import shutil
import sqlite3
import sys
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

folder = Path(sys.argv[1])
store = get_typestore(Stores.ROS2_HUMBLE)
text = store.types["std_msgs/msg/String"]
bag = folder / "bag"
with Writer(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
    topic = writer.add_connection("/words", text.__msgtype__, typestore=store)
    for k in range(20):
        data = store.serialize_cdr(text(data=str(k)), text.__msgtype__)
        writer.write(topic, 1_000_000_000 + k, data)
file = bag / "bag.db3"
recorder = sqlite3.connect(file)
late = recorder.execute("SELECT * FROM messages ORDER BY timestamp LIMIT 8 OFFSET 12").fetchall()
recorder.executemany("DELETE FROM messages WHERE id = ?", [(row[0],) for row in late])
recorder.commit()
recorder.execute("PRAGMA journal_mode=WAL")
recorder.execute("PRAGMA wal_autocheckpoint=0")
recorder.executemany(f"INSERT INTO messages VALUES ({','.join('?' * len(late[0]))})", late)
recorder.commit()
killed = folder / "killed"
killed.mkdir()
for name in ("bag.db3", "bag.db3-wal"):  # as they lie there when the recorder is killed
    shutil.copyfile(bag / name, killed / name)
with AnyReader([killed / "bag.db3"], default_typestore=store) as reader:
    by_rosbags = sum(1 for _ in reader.messages())
plain = sqlite3.connect(killed / "bag.db3").execute("SELECT COUNT(*) FROM messages").fetchone()[0]
print(f"rosbags: {by_rosbags} messages, sqlite3: {plain}")
assert (by_rosbags, plain) == (12, 20)
print("as described")
PY
PYTHONPATH="$folder/lib" python3 "$folder/try.py" "$folder"
