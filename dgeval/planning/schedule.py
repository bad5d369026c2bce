"""When a stage's result becomes usable. The papers run perception and control side by side; replay says so in numbers."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Delayed(Generic[T]):
    """Results of one stage, each usable from its image's time plus a latency on."""

    def __init__(self, latency_s: float) -> None:
        self._latency_ns = round(latency_s * 1e9)
        self.reset()

    def reset(self) -> None:
        self._coming: deque[tuple[int, T]] = deque()
        self._usable: tuple[int, T] | None = None

    def step(self, t_ns: int, result: T) -> tuple[int, T] | None:
        """Take this frame's result in; give the newest usable one and the time of its image, or None."""
        self._coming.append((t_ns, result))
        return self.at(t_ns)

    def at(self, t_ns: int) -> tuple[int, T] | None:
        """The newest result usable at a time."""
        while self._coming and self._coming[0][0] + self._latency_ns <= t_ns:
            self._usable = self._coming.popleft()
        return self._usable
