"""Chooses the reader of a recording by its first bytes, and puts its parts together."""

from __future__ import annotations

import gzip
import re
import shutil
import tempfile
import weakref
import zlib
from pathlib import Path

import zstandard
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from dgeval.errors import Damage, Place, UnreadableError, describe
from dgeval.recording.containers.container import (
    MCAP_MAGIC,
    SQLITE_MAGIC,
    ZSTD_MAGIC,
    Container,
    Opened,
)

BAG_MAGIC = b"#ROSBAG V"
ZIP_MAGIC, TAR_MAGIC = b"PK\x03\x04", b"ustar"  # tar's from the 257th byte on
GZIP_MAGIC = b"\x1f\x8b"
# by the first bytes: with what a file is compressed, and what takes it out
OTHER_PACKING = {
    b"\x04\x22\x4d\x18": ("lz4", "unlz4 FILE"),
    b"\xfd7zXZ\x00": ("xz", "unxz FILE"),
    b"BZh": ("bzip2", "bunzip2 FILE"),
}
PACKED = (".zstd", ".zst", ".gz")  # behind a name: the file is compressed as a whole
STORED = (".mcap", ".db3")  # what a ROS 2 folder holds, also with .zstd behind it
METADATA = "metadata.yaml"
MOST_NAMED = 3  # topics in a sentence
LISTED = re.compile(
    r"^\s*-\s+(?:path:\s*)?\"?([^\s\"]+\.(?:mcap|db3)(?:\.zstd)?)\"?\s*$", re.MULTILINE
)


def open_container(path: Path, parts: tuple[Path, ...] = ()) -> Opened:
    """Open a recording by its content: MCAP, ROS 1 bag, ROS 2 folder or bare .db3.

    parts: files that together are the recording, in order; `path` names them. UnreadableError says
    why it can't be opened.
    """
    place = Place(str(path))
    try:
        if lost := [part for part in parts if not part.exists()]:
            raise UnreadableError("no such file or folder", Place(str(lost[0])))
        if len(parts) > 1:
            return Opened(_joined(path, list(parts)), path)
        if not path.exists():
            raise UnreadableError("no such file or folder", place)
        if path.is_dir():
            return Opened(_folder(path), path)
        return Opened(_file(path), path)
    except OSError as error:
        raise UnreadableError(f"can't be opened ({error.strerror})", place) from error


def stored_files(folder: Path) -> list[Path]:
    """The .mcap and .db3 files of a ROS 2 folder, compressed or not, in the recording's order.

    The order is that of metadata.yaml where it lists them all, else that of the numbers at the ends
    of their names.
    """
    files = [p for p in folder.iterdir() if _bare(p).suffix in STORED]
    listed = _listed(folder)

    def key(p: Path) -> tuple[int, int, str]:
        named = next((k for k, n in enumerate(listed) if n in (p.name, _bare(p).name)), len(listed))
        number = re.search(r"_(\d+)$", _bare(p).stem)
        return named, int(number[1]) if number else -1, p.name

    return sorted(files, key=key)


def _metadata(folder: Path) -> str:
    """The text of a ROS 2 folder's metadata.yaml; "" without."""
    file = folder / METADATA
    return file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""


def _listed(folder: Path) -> list[str]:
    """Names of the files that a ROS 2 folder's metadata.yaml lists, in its order."""
    return [Path(name).name for name in LISTED.findall(_metadata(folder))]


def _bare(path: Path) -> Path:
    """The path without the suffix of a compression at its end."""
    return path.with_suffix("") if path.suffix in PACKED else path


def _folder(path: Path) -> Container:
    """A ROS 2 folder: one file, or several that are one recording by its metadata.yaml."""
    from dgeval.recording.containers.rosbags import RosbagsContainer

    files = stored_files(path)
    if not files:
        raise UnreadableError(
            "a folder without a .mcap or .db3 file is not a ROS 2 recording", Place(str(path))
        )
    text = _metadata(path)
    # a recorder that died leaves no metadata.yaml; rosbag2 names the parts after their folder
    own = len(files) > 1 and all(
        re.fullmatch(rf"{re.escape(path.name)}_\d+", _bare(f).stem) for f in files
    )
    if _bare(files[0]).suffix == ".db3" and (text or len(files) == 1 or not own):
        return RosbagsContainer(path)
    if len(files) > 1 and not text and not own:
        raise UnreadableError(
            f"{len(files)} recordings in one folder, and no metadata.yaml says that they are one",
            Place(str(path)),
            "give them one by one, or in a manifest",
        )
    joined = _joined(path, files)
    fewer = _fewer_than_listed(joined, text)
    if fewer:
        joined.damage.append(Damage(fewer, Place(str(path / METADATA))))
    return joined


def _fewer_than_listed(joined: Container, text: str) -> str:
    """In words, of which topics the files hold fewer messages than their metadata.yaml counts."""
    try:
        listed = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
        counts = {
            one["topic_metadata"]["name"]: int(one["message_count"])
            for one in listed["topics_with_message_count"]
        }
    except (YAMLError, KeyError, TypeError, ValueError, RecursionError):
        return ""  # no metadata.yaml, or another program's
    held = {name: topic.count for name, topic in joined.topics.items()}
    fewer = [
        f"{count} on {name}, and {held.get(name, 0)} are there"
        for name, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        if (there := held.get(name, 0)) is not None and there < count
    ]
    if not fewer:
        return ""
    more = f"; and so on {len(fewer) - MOST_NAMED} topics more" if len(fewer) > MOST_NAMED else ""
    return f"{METADATA} counts messages that are lost: {'; '.join(fewer[:MOST_NAMED])}{more}"


def missing_parts(folder: Path) -> list[str]:
    """Files that a ROS 2 folder's metadata.yaml lists, and that are not there."""
    there = {name for p in folder.iterdir() for name in (p.name, _bare(p).name)}
    return [
        n
        for n in sorted(set(_listed(folder)))
        if n not in there and _bare(Path(n)).name not in there
    ]


def _joined(path: Path, files: list[Path]) -> Container:
    from dgeval.recording.containers.parts import PartsContainer

    opened: list[Container] = []
    lost: list[tuple[int, Path, str]] = []  # how many parts before it could be read, and why not it
    for file in files:
        try:
            opened.append(_file(file))
        except UnreadableError as error:
            if len(files) == 1 or (file == files[-1] and not opened):
                raise
            # one that its recorder had just begun when it was killed, or that was copied in part
            what = f"{file.name} can't be read ({error.what}): what it holds is missing"
            lost.append((len(opened), file, what))
    ends = [part.span_ns for part in opened]
    for before, file, what in lost:
        start = ends[before - 1] if before else None
        stop = ends[before] if before < len(ends) else None
        damage = Damage(
            what,
            Place(str(file)),
            lost_from_ns=None if start is None else start[1],
            lost_to_ns=None if stop is None or start is None else stop[0],
        )
        opened[max(0, before - 1)].damage.append(damage)
    return opened[0] if len(files) == 1 else PartsContainer(path, opened)


def _file(path: Path) -> Container:
    """One file by its first bytes."""
    from dgeval.recording.containers.mcap import McapContainer
    from dgeval.recording.containers.rosbags import RosbagsContainer

    place = Place(str(path))
    with path.open("rb") as stream:
        begin = stream.read(512)
    head = begin[:16]
    if not head:
        raise UnreadableError("the file is empty", place)
    if head.startswith(ZIP_MAGIC) or begin[257:262] == TAR_MAGIC:
        raise UnreadableError("an archive", place, "unpack it, and give what is in it")
    if head.startswith((ZSTD_MAGIC, GZIP_MAGIC)):
        return _decompressed(path)
    if head.startswith(MCAP_MAGIC):
        return McapContainer(path)
    if head.startswith(BAG_MAGIC) or head == SQLITE_MAGIC:
        return RosbagsContainer(path)
    for magic, (packing, unpack) in OTHER_PACKING.items():
        if head.startswith(magic):
            what = f"compressed as a whole with {packing}, which is not read"
            raise UnreadableError(what, place, f"unpack it ({unpack}), or compress it with zstd")
    hint: str | None = None
    if head.startswith(b"version https://"):
        hint = "this is a git-LFS pointer, not the recording: run `git lfs pull`"
    elif head.lstrip()[:1] == b"<":
        hint = "this is a web page, not the recording: download it again"
    raise UnreadableError(
        "neither MCAP, ROS 1 bag nor ROS 2 SQLite by its first bytes", place, hint
    )


def _decompressed(path: Path) -> Container:
    """A file that was compressed as a whole, from a temporary copy that lives with the reader."""
    folder = tempfile.mkdtemp(prefix="dgeval-")
    copy = Path(folder) / _bare(path).name
    with path.open("rb") as stream:
        is_gzip = stream.read(2) == GZIP_MAGIC
    kind, hint = ("gzip", "`gunzip`") if is_gzip else ("zstd", "`zstd -d`")
    try:
        with path.open("rb") as packed, copy.open("wb") as plain:
            if is_gzip:
                with gzip.open(packed) as unpacked:
                    shutil.copyfileobj(unpacked, plain)
            else:
                zstandard.ZstdDecompressor().copy_stream(packed, plain)
    except (zstandard.ZstdError, gzip.BadGzipFile, EOFError, zlib.error) as error:
        shutil.rmtree(folder, ignore_errors=True)
        what = f"its {kind} compression is damaged ({describe(error)})"
        raise UnreadableError(what, Place(str(path)), f"{hint} may save a part") from error
    try:
        container = _file(copy)
    except UnreadableError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise UnreadableError(error.what, Place(str(path)), error.hint) from error
    container.path = path
    weakref.finalize(container, shutil.rmtree, folder, ignore_errors=True)
    return container
