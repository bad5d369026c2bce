"""The tf tree over time: poses are interpolated, never extrapolated."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, interpolate_pose, invert, matrix_from_pose

EXACT_NS = 1_000  # ns; a sample this near in time is used as it is
# m and quaternion parts; two poses that differ by less are one mount, published now and then
SAME = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])


@dataclass
class Track:
    """A pose over time, stamps rising; poses (7,) px py pz qx qy qz qw."""

    times: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    out_of_order: int = 0

    def add(self, t_ns: int, pose: Array) -> None:
        """Add a sample; a repeated stamp is dropped, an older one is sorted in and counted."""
        if not self.times or t_ns > self.times[-1]:
            self.times.append(t_ns)
            self.poses.append(pose)
            return
        at = bisect_left(self.times, t_ns)
        if self.times[at] != t_ns:
            self.out_of_order += 1
            self.times.insert(at, t_ns)
            self.poses.insert(at, pose)

    def sample(self, t_ns: int, max_gap_ns: int) -> Array | None:
        """(7,) pose at a time: a sample within EXACT_NS, else interpolated over at most max_gap_ns.

        None outside the samples, or in a longer gap over which the pose changes.
        """
        at = bisect_left(self.times, t_ns)
        for i in (at - 1, at):
            if 0 <= i < len(self.times) and abs(self.times[i] - t_ns) <= EXACT_NS:
                return self.poses[i]
        if at == 0 or at == len(self.times):
            return None
        before, after = self.times[at - 1], self.times[at]
        apart = np.abs(self.poses[at] - self.poses[at - 1])
        if after - before > max_gap_ns and (apart > SAME).any():
            return None
        return interpolate_pose(
            self.poses[at - 1], self.poses[at], (t_ns - before) / (after - before)
        )


@dataclass
class TransformTree:
    """Frames and the edges to their parents: moving (recorded), static, or computed from joints."""

    max_gap_ns: int = 500_000_000
    moving: dict[str, tuple[str, Track]] = field(default_factory=dict)
    static: dict[str, tuple[str, NDArray[np.float64]]] = field(default_factory=dict)
    computed: dict[str, tuple[str, Callable[[int], Array | None]]] = field(default_factory=dict)
    reparented: int = 0

    def add_moving(self, t_ns: int, parent: str, child: str, pose: Array) -> None:
        known = self.moving.get(child)
        if known is None:
            known = self.moving[child] = (parent, Track())
        if known[0] != parent:
            self.reparented += 1  # a frame has one parent in tf; the first one recorded stays
            return
        known[1].add(t_ns, pose)

    def add_static(self, parent: str, child: str, T_parent_child: Array) -> None:
        self.static[child] = (parent, T_parent_child)

    def frames(self) -> set[str]:
        out: set[str] = set()
        for edges in (self.moving, self.static, self.computed):
            for child, edge in edges.items():
                out |= {child, edge[0]}
        return out

    def parent(self, frame: str) -> str | None:
        for edges in (self.moving, self.static, self.computed):
            if frame in edges:
                return edges[frame][0]
        return None

    def root(self, frame: str) -> str:
        """The topmost frame above this one; a cycle ends where it closes."""
        return self.ancestors(frame)[-1]

    def ancestors(self, frame: str) -> list[str]:
        """The frame itself, its parent, and so on up."""
        chain = [frame]
        while (above := self.parent(chain[-1])) is not None and above not in chain:
            chain.append(above)
        return chain

    def _edge(self, child: str, t_ns: int) -> Array | None:
        """T_parent_child at a time; a recorded edge goes before a computed one."""
        if child in self.moving:
            pose = self.moving[child][1].sample(t_ns, self.max_gap_ns)
            return None if pose is None else matrix_from_pose(pose)
        if child in self.static:
            return self.static[child][1]
        return self.computed[child][1](t_ns)

    def lookup(self, target: str, source: str, t_ns: int) -> Array | None:
        """T_target_source (4, 4) at a time; None if not connected, or not known then."""
        up_source, up_target = self.ancestors(source), self.ancestors(target)
        common = next((f for f in up_source if f in up_target), None)
        if common is None:
            return None
        halves = []
        for chain in (up_target, up_source):
            T = np.eye(4)
            for child in chain[: chain.index(common)]:
                edge = self._edge(child, t_ns)
                if edge is None:
                    return None
                T = edge @ T
            halves.append(T)
        T_common_target, T_common_source = halves
        return invert(T_common_target) @ T_common_source
