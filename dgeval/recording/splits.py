"""Which files together are one recording that its recorder split by size or time.

`rosbag record --split` and rosbag2 number the parts from 0. Numbers alone are no proof, trials are
numbered too: each part must also begin where the one before ends.
"""

from __future__ import annotations

import re
from pathlib import Path

from dgeval.errors import UnreadableError
from dgeval.recording.containers.container import Opened
from dgeval.recording.containers.opening import open_container

NUMBERED = re.compile(
    r"(?P<stem>.*?)(?:(?:^|_)\d{4}(?:-\d\d){5})?_(?P<k>\d+)(?P<suffix>\.bag|\.mcap|\.db3)"
)
# ns, at most between two parts: a split loses no message, a recorder that is started again for the
# next trial takes longer; ours
GAP_NS = 500_000_000

MOSTLY = 0.5  # share of the shorter one's time, over which both were recorded; ours
MOST_BESIDE = 20  # files of a folder that are looked at

Numbered = dict[tuple[Path, str, str], dict[int, Path]]  # by folder, name and suffix; by number


def split_recordings(paths: list[Path]) -> list[tuple[Path, ...]]:
    """Recordings as tuples of their files, in the order of `paths`; most are of one file."""
    groups = _numbered(paths)
    together: dict[Path, tuple[Path, ...]] = {}
    for numbers in groups.values():
        files = [numbers[k] for k in sorted(numbers)]
        if len(files) > 1 and sorted(numbers) == list(range(len(files))) and _follow(files):
            together |= dict.fromkeys(files, tuple(files))
    return [together.get(path, (path,)) for path in paths if together.get(path, (path,))[0] == path]


def unread_part(path: Path, read: tuple[Path, ...] = ()) -> Path | None:
    """The file beside a recording that is its next or previous part, and not among those that are
    read; None without.
    """
    match = NUMBERED.fullmatch(path.name)
    if match is None or not path.is_file():
        return None
    groups = _numbered(sorted(path.parent.glob(f"*{match['suffix']}")))
    numbers = groups[path.parent, match["stem"], match["suffix"]]
    k = int(match["k"])
    for pair in ((k, k + 1), (k - 1, k)):
        files = [numbers[i] for i in pair if i in numbers]
        if len(files) == 2 and not set(files) <= set(read) and _follow(files):
            return next(file for file in files if file != path)
    return None


def of_another_computer(path: Path) -> Path | None:
    """The file beside a recording that was recorded over the same time and shares no topic with it,
    as the robot's computer has it beside the camera's; None without, or where several are.
    """
    try:
        own = open_container(path)
    except UnreadableError:
        return None
    span = own.container.span_ns
    if span is None:
        return None
    alike = [p for p in sorted(path.parent.iterdir()) if p.suffix == path.suffix and p != path]
    found = []
    for file in [p for p in alike if p.is_file() == path.is_file()][:MOST_BESIDE]:
        try:
            other = open_container(file)
        except UnreadableError:
            continue
        theirs = other.container.span_ns
        if theirs is None or own.topics.keys() & other.topics.keys():
            continue
        shared = min(span[1], theirs[1]) - max(span[0], theirs[0])
        if shared > MOSTLY * min(span[1] - span[0], theirs[1] - theirs[0]):
            found.append(file)
    return found[0] if len(found) == 1 else None


def _numbered(paths: list[Path]) -> Numbered:
    groups: Numbered = {}
    for path in paths:
        match = NUMBERED.fullmatch(path.name) if path.is_file() else None
        if match is not None:
            key = path.parent, match["stem"], match["suffix"]
            groups.setdefault(key, {})[int(match["k"])] = path
    return groups


def _follow(files: list[Path]) -> bool:
    """Whether each file begins within GAP_NS of the end of the one before, with the same topics.

    The first pair that doesn't ends the search: numbered trials are opened no further than that.
    The last one holds nothing where the recorder was killed: it belongs to those before it if they
    are several, or named after their folder as rosbag2 names them.
    """
    before: Opened | None = None
    end_ns = 0
    for file in files:
        try:
            opened = open_container(file)
            span = opened.span_ns()
        except UnreadableError:
            span = None
        if span is None:
            named = NUMBERED.fullmatch(file.name)
            own = named is not None and named["stem"] == file.parent.name
            return file == files[-1] and before is not None and (len(files) > 2 or own)
        if before is not None and (
            not before.topics.keys() & opened.topics.keys() or not 0 <= span[0] - end_ns < GAP_NS
        ):
            return False
        before, end_ns = opened, span[1]
    return True
