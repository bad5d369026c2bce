"""When a stage's result becomes usable.

The papers run perception and control in parallel; replay models this by a latency per stage.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Delayed(Generic[T]):
    """Results of one stage. Each is usable from its image's time plus the latency on."""

    def __init__(self, latency_s: float) -> None:
        self._latency_ns = round(latency_s * 1e9)
        self.reset()

    def reset(self) -> None:
        self._pending: deque[tuple[int, T]] = deque()
        self._usable: tuple[int, T] | None = None

    def step(self, t_ns: int, result: T) -> tuple[int, T] | None:
        """Add the result of the image at t_ns; return the newest usable one, as `at`."""
        self._pending.append((t_ns, result))
        return self.at(t_ns)

    def at(self, t_ns: int) -> tuple[int, T] | None:
        """The newest result usable at t_ns with its image's time ns; None before the first."""
        while self._pending and self._pending[0][0] + self._latency_ns <= t_ns:
            self._usable = self._pending.popleft()
        return self._usable
