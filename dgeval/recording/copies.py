"""Files of a run that hold what another one holds: copies, and what `rosbag reindex` keeps.

Each counts as another trial, with the same outcome as the one it repeats. And archives in a folder.
"""

from __future__ import annotations

import tarfile
import zipfile
from collections import defaultdict
from pathlib import Path

from dgeval.recording.containers.container import sha256_of

COUNTS_TWICE = "one trial that counts twice"  # the end of such a trial's note
ORIGINAL = ".orig.bag"  # behind the name of a bag that `rosbag reindex` or `rosbag fix` read
TARS, ZIP = (".tar", ".tar.gz", ".tgz", ".tar.xz", ".txz", ".tar.bz2", ".tbz2"), ".zip"
MOST_MEMBERS = 200  # of an archive, that are looked at


def repeats(files: list[Path]) -> dict[Path, str]:
    """By file that repeats another of the files, the sentence that says so."""
    out: dict[Path, str] = {}
    there = set(files)
    for file in files:
        if file.name.endswith(ORIGINAL):
            reindexed = file.with_name(file.name[: -len(ORIGINAL)] + ".bag")
            if reindexed in there:
                out[file] = f"what `rosbag reindex` made {reindexed.name} from"
    by_size: dict[int, list[Path]] = defaultdict(list)
    for file in files:
        if file.is_file() and file not in out:
            by_size[file.stat().st_size].append(file)
    for alike in by_size.values():
        first: dict[str, Path] = {}
        for file in alike if len(alike) > 1 else []:
            other = first.setdefault(sha256_of(file), file)
            if other is not file:
                out[file] = f"the same bytes as {other.name}"
    return out


def holds_a_recording(archive: Path, suffixes: tuple[str, ...]) -> bool:
    """Whether a tar or zip archive, known by its name, lists a file with one of the suffixes."""
    name = archive.name.lower()
    try:
        if name.endswith(ZIP):
            with zipfile.ZipFile(archive) as stored:
                listed = stored.namelist()[:MOST_MEMBERS]
        elif name.endswith(TARS):
            with tarfile.open(archive) as stored_tar:
                listed = [m.name for m, _ in zip(stored_tar, range(MOST_MEMBERS), strict=False)]
        else:
            return False
    except (OSError, EOFError, tarfile.TarError, zipfile.BadZipFile, ValueError):
        return False
    return any(Path(member).suffix in suffixes for member in listed)
