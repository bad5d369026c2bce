"""Several files that are one recording: rosbag2's and rosbag's splits, as one container."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from heapq import merge
from pathlib import Path

from dgeval.errors import Damage
from dgeval.recording.containers.container import Container, RawMessage, Topic


class PartsContainer:
    """Parts in the order of the recording; messages are merged by log time, ties by part."""

    def __init__(self, path: Path, parts: list[Container]) -> None:
        self.path, self._parts = path, parts
        self.kind = f"{parts[0].kind}, {len(parts)} parts"
        self.topics: dict[str, Topic] = {}
        for part in parts:
            for name, topic in part.topics.items():
                known = self.topics.get(name)
                if known is not None:
                    both = known.count is not None and topic.count is not None
                    count = (known.count or 0) + (topic.count or 0) if both else None
                    topic = replace(known, count=count)
                self.topics[name] = topic
        self.span_ns: tuple[int, int] | None = None
        self.notes = list(dict.fromkeys(note for part in parts for note in part.notes))

    @property
    def damage(self) -> list[Damage]:
        """The damage of all parts, of each what it found so far."""
        return _Joined(self._parts)

    @property
    def checksums(self) -> str:
        return "; ".join(dict.fromkeys(part.checksums for part in self._parts))

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Messages of the topics in log-time order. Parts that do not overlap are read in turn."""
        streams = [part.messages(topics & part.topics.keys()) for part in self._parts]
        return merge(*streams, key=lambda m: m.log_ns)


class _Joined(list[Damage]):
    """The damage lists of several parts; what is added goes to the first."""

    def __init__(self, parts: list[Container]) -> None:
        super().__init__(d for part in parts for d in part.damage)
        self._first = parts[0].damage

    def append(self, damage: Damage) -> None:
        super().append(damage)
        self._first.append(damage)
