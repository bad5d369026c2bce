"""Chooses the reader of a recording by its first bytes."""

from __future__ import annotations

from pathlib import Path

from dgeval.errors import Place, UnreadableError
from dgeval.recording.containers.container import MCAP_MAGIC, Opened

BAG_MAGIC = b"#ROSBAG V"

SQLITE_MAGIC = b"SQLite format 3\x00"


def open_container(path: Path) -> Opened:
    """Open a recording by its content: MCAP, ROS 1 bag, ROS 2 folder or bare .db3.

    UnreadableError says why it can't be opened.
    """
    from dgeval.recording.containers.mcap import McapContainer
    from dgeval.recording.containers.rosbags import RosbagsContainer

    place = Place(str(path))
    try:
        if not path.exists():
            raise UnreadableError("no such file or folder", place)
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))
            if len(inside) == 1 and inside[0].suffix == ".mcap":
                return Opened(McapContainer(inside[0]), path)
            if not inside:
                raise UnreadableError(
                    "a folder without a .mcap or .db3 file is not a ROS 2 recording", place
                )
            if any(p.suffix == ".mcap" for p in inside):
                raise UnreadableError(
                    f"{len(inside)} recordings in one folder", place, "give the parts as a manifest"
                )
            return Opened(RosbagsContainer(path), path)
        with path.open("rb") as stream:
            head = stream.read(16)
        if not head:
            raise UnreadableError("the file is empty", place)
        if head.startswith(MCAP_MAGIC):
            return Opened(McapContainer(path), path)
        if head.startswith(BAG_MAGIC) or head == SQLITE_MAGIC:
            return Opened(RosbagsContainer(path), path)
    except OSError as error:
        raise UnreadableError(f"can't be opened ({error.strerror})", place) from error
    hint: str | None = None
    if head.startswith(b"version https://"):
        hint = "this is a git-LFS pointer, not the recording: run `git lfs pull`"
    elif head.lstrip()[:1] == b"<":
        hint = "this is a web page, not the recording: download it again"
    raise UnreadableError(
        "neither MCAP, ROS 1 bag nor ROS 2 SQLite by its first bytes", place, hint
    )
