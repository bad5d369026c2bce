"""The tf tree over time: poses are interpolated, never extrapolated."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, interpolate_pose, invert, matrix_from_pose, pose_from_matrix

EXACT_NS = 1_000  # ns; a sample this near in time is used as it is
# m and quaternion parts; two poses that differ by less are one mount, published now and then
SAME = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])


@dataclass
class Track:
    """A pose over time, stamps rising; poses (7,) px py pz qx qy qz qw, each in its own parent."""

    times: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    parents: list[str] = field(default_factory=list)
    out_of_order: int = 0
    has_one_parent: bool = True

    def add(self, t_ns: int, pose: Array, parent: str = "") -> None:
        """Add a sample; a repeated stamp is dropped, an older one is sorted in and counted."""
        at = len(self.times)
        if self.times and t_ns <= self.times[-1]:
            at = bisect_left(self.times, t_ns)
            if self.times[at] == t_ns:
                return
            self.out_of_order += 1
        self.has_one_parent &= not self.parents or parent == self.parents[0]
        self.times.insert(at, t_ns)
        self.poses.insert(at, pose)
        self.parents.insert(at, parent)

    def parent_at(self, t_ns: int) -> str:
        """The parent that the pose at a time is given in: as in tf2, the earlier sample's."""
        if self.has_one_parent:
            return self.parents[0]
        at = bisect_left(self.times, t_ns + EXACT_NS + 1) - 1
        return self.parents[max(at, 0)]

    def sample(self, t_ns: int, max_gap_ns: int) -> Array | None:
        """(7,) pose at a time: a sample within EXACT_NS, else interpolated over at most max_gap_ns.

        None outside the samples, or in a longer gap over which the pose or its parent changes.
        Between samples with two parents the earlier one counts.
        """
        at = bisect_left(self.times, t_ns)
        for i in (at - 1, at):
            if 0 <= i < len(self.times) and abs(self.times[i] - t_ns) <= EXACT_NS:
                return self.poses[i]
        if at == 0 or at == len(self.times):
            return None
        before, after = self.times[at - 1], self.times[at]
        apart = np.abs(self.poses[at] - self.poses[at - 1])
        moved = self.parents[at] != self.parents[at - 1]
        if after - before > max_gap_ns and (moved or (apart > SAME).any()):
            return None
        if moved:
            return self.poses[at - 1]
        return interpolate_pose(
            self.poses[at - 1], self.poses[at], (t_ns - before) / (after - before)
        )


def _w_first(pose: Array) -> Array:
    """(7,) the pose whose quaternion was written w x y z into x y z w."""
    return np.concatenate([pose[:3], np.roll(pose[3:], -1)])


Ways = tuple[tuple[str, ...], tuple[str, ...]]


@dataclass
class TransformTree:
    """Frames and the edges to their parents: moving (recorded), static, or computed from joints."""

    max_gap_ns: int = 500_000_000
    moving: dict[str, tuple[str, Track]] = field(default_factory=dict)
    static: dict[str, tuple[str, NDArray[np.float64]]] = field(default_factory=dict)
    computed: dict[str, tuple[str, Callable[[int], Array | None]]] = field(default_factory=dict)
    # by (target, source), the frames from each up to where they meet; empty after any change
    _ways: dict[tuple[str, str], Ways | None] = field(default_factory=dict, repr=False)
    # the edges at the time that was asked for last, and that time; empty after any change
    _edges: dict[str, Array | None] = field(default_factory=dict, repr=False)
    _back: dict[tuple[str, ...], Array | None] = field(default_factory=dict, repr=False)
    _edges_ns: int = 0

    def add_moving(self, t_ns: int, parent: str, child: str, pose: Array) -> None:
        """Add a sample; each one has its own parent, as in tf2."""
        self._forget()
        if child not in self.moving:
            self.moving[child] = (parent, Track())
        self.moving[child][1].add(t_ns, pose, parent)

    def _forget(self) -> None:
        """What was found out before a change."""
        self._ways.clear()
        self._edges.clear()
        self._back.clear()

    def reparented(self) -> dict[str, list[str]]:
        """The frames whose parent changes, each with its parents by name."""
        return {
            child: sorted(set(track.parents))
            for child, (_, track) in sorted(self.moving.items())
            if not track.has_one_parent
        }

    def drop_moving(self, child: str) -> None:
        """Forget the samples of a frame, if it has any."""
        self._forget()
        self.moving.pop(child, None)

    def drop(self, child: str) -> None:
        """Forget a frame's recorded parent, moving or static."""
        self.drop_moving(child)
        self.static.pop(child, None)

    def add_computed(self, parent: str, child: str, edge: Callable[[int], Array | None]) -> None:
        """Add a frame whose T_parent_child (4, 4) follows from a time, ns; None where unknown."""
        self._forget()
        self.computed[child] = (parent, edge)

    def with_w_first(self, child: str) -> TransformTree | None:
        """The tree with the recorded quaternions of one frame read as w x y z; None where none of
        it is recorded.
        """
        if child in self.moving:
            parent, track = self.moving[child]
            other = replace(track, poses=[_w_first(pose) for pose in track.poses])
            return replace(
                self, moving={**self.moving, child: (parent, other)}, _edges={}, _back={}
            )
        if child in self.static:
            parent, T = self.static[child]
            turned = matrix_from_pose(_w_first(pose_from_matrix(T)))
            return replace(
                self, static={**self.static, child: (parent, turned)}, _edges={}, _back={}
            )
        return None

    def add_static(self, parent: str, child: str, T_parent_child: Array) -> None:
        self._forget()
        self.static[child] = (parent, T_parent_child)

    def frames(self) -> set[str]:
        out: set[str] = set()
        for edges in (self.moving, self.static, self.computed):
            for child, edge in edges.items():
                out |= {child, edge[0]}
        return out

    def parent(self, frame: str, t_ns: int | None = None) -> str | None:
        """The frame's parent at a time; without one the first that was recorded."""
        if t_ns is not None and frame in self.moving:
            return self.moving[frame][1].parent_at(t_ns)
        for edges in (self.moving, self.static, self.computed):
            if frame in edges:
                return edges[frame][0]
        return None

    def root(self, frame: str) -> str:
        """The topmost frame above this one; a cycle ends where it closes."""
        return self.ancestors(frame)[-1]

    def ancestors(self, frame: str, t_ns: int | None = None) -> list[str]:
        """The frame itself, its parent, and so on up; at a time, or as first recorded."""
        chain = [frame]
        while (above := self.parent(chain[-1], t_ns)) is not None and above not in chain:
            chain.append(above)
        return chain

    def _edge(self, child: str, t_ns: int) -> Array | None:
        """T_parent_child at a time; kept, as one time is asked for by camera, palm and fingers."""
        self._at(t_ns)
        if child not in self._edges:
            self._edges[child] = self._edge_at(child, t_ns)
        return self._edges[child]

    def _at(self, t_ns: int) -> None:
        """What is kept is of one time."""
        if t_ns != self._edges_ns:
            self._edges.clear()
            self._back.clear()
            self._edges_ns = t_ns

    def _edge_at(self, child: str, t_ns: int) -> Array | None:
        """T_parent_child at a time; a recorded edge goes before a computed one."""
        if child in self.moving:
            pose = self.moving[child][1].sample(t_ns, self.max_gap_ns)
            return None if pose is None else matrix_from_pose(pose)
        if child in self.static:
            return self.static[child][1]
        return self.computed[child][1](t_ns)

    def lookup(self, target: str, source: str, t_ns: int) -> Array | None:
        """T_target_source (4, 4) at a time; None if not connected, or not known then."""
        ways = self._ways_to(target, source, t_ns)
        if ways is None:
            return None
        way_to_target, way_to_source = ways
        T_common_source = self._along(way_to_source, t_ns)
        if T_common_source is None:
            return None
        if not way_to_target:
            return T_common_source.copy()
        T_target_common = self._back_along(way_to_target, t_ns)
        return None if T_target_common is None else T_target_common @ T_common_source

    def _along(self, way: tuple[str, ...], t_ns: int) -> Array | None:
        """T_top_frame (4, 4) of the frames from one up to below the top; None if not known then."""
        T: Array | None = None
        for child in way:
            edge = self._edge(child, t_ns)
            if edge is None:
                return None
            T = edge if T is None else edge @ T
        return np.eye(4) if T is None else T

    def _back_along(self, way: tuple[str, ...], t_ns: int) -> Array | None:
        """The inverse of `_along`; kept, as each link of a hand is asked for in the camera."""
        self._at(t_ns)
        if way not in self._back:
            T = self._along(way, t_ns)
            self._back[way] = None if T is None else invert(T)
        return self._back[way]

    def _ways_to(self, target: str, source: str, t_ns: int) -> Ways | None:
        """The frames from target and from source up to the first that is above both."""
        if (target, source) in self._ways:
            return self._ways[target, source]
        up_target, up_source = self.ancestors(target, t_ns), self.ancestors(source, t_ns)
        common = next((f for f in up_source if f in up_target), None)
        ways = None
        if common is not None:
            ways = (
                tuple(up_target[: up_target.index(common)]),
                tuple(up_source[: up_source.index(common)]),
            )
        passed = (f for f in (*up_target, *up_source) if f in self.moving)
        if all(self.moving[f][1].has_one_parent for f in passed):  # it is the same at all times
            self._ways[target, source] = ways
        return ways
