"""What a gripper's own topics say of its closing: commands, goals of actions, and its width.

Nothing tells whether a larger number opens or closes a hand: widths shrink, the joint of a Robotiq
grows. But the last time that the gripper is told to move, or moves, before the palm rises, it
closes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array

WIDTHS = ("width", "opening")  # in the names of topics whose number grows as the hand opens
GRIPPER_WORDS = ("gripper", "finger", "jaw", "hand")
COMMAND_WORDS = ("command", "cmd", "goal", "desired", "target", "setpoint")
# words in the last part of a topic's name that is no position, and that is an effort
NO_POSITION = ("speed", "veloc", "temp", "volt", "rate", "status_code")
# parts of a topic's name that say that it is something on the hand
NOT_THE_HAND = ("camera", "light", "led", "imu", "battery", "sound", "handle", "handover")
EFFORT_WORDS = ("force", "effort", "torque", "current")
# types whose number is what a gripper is told to do
COMMAND_TYPES = ("Goal", "GripperCommand", "robot_output", "CommandedState")
# what ROS 2 records of an action: which goals it has, and since when
GOALS = "action_msgs/msg/GoalStatusArray"
# where a message of a gripper has its number, tried in turn
PATHS = (
    ("goal", "command", "position"),
    ("feedback", "position"),
    ("feedback", "current_width"),
    ("goal", "width"),
    ("command", "position"),
    ("position",),
    ("width",),
    ("rPR",),
    ("gPO",),
    ("data",),
)
NUMBERS = tuple(
    f"std_msgs/msg/{kind}{bits}"
    for kind, sizes in (("Float", (32, 64)), ("Int", (8, 16, 32, 64)), ("UInt", (8, 16, 32, 64)))
    for bits in sizes
)
# yes or no: a command where the topic's last name says so, since a state comes only after it
BOOL, ORDERS = "std_msgs/msg/Bool", ("close", "open", "grasp", "release")
CHANGES_BY = 0.10  # share of its range by which a command changes, to be a new one; ours
SINGLE = 3  # messages of a command topic, up to which each of them is a command by itself; ours
MOVES_BY = 0.20  # share of the recorded range that a closing motion covers, also of fingers
SMOOTHED = 9  # samples of an effort, of which the median counts; ours
OVER_NOISE = 20.0  # times its noise, that an effort's range must be to tell something; ours
WITHIN_S = 1.5  # s, in which it does so
# samples of a width, from which on noise is told from motion, and times the usual step between two,
# below which the range of all is noise; ours
DENSE, TREMBLES = 50, 12.0
OPENS_BY = 0.25  # share of its range, within which a command is the one that opens; ours
# s after a close, by which its command is given and its fingers rest; and share of the range by
# which they are then told elsewhere, to be an opening; ours
SETTLES_S, RELEASED_BY = 1.0, 0.5
# by the last name of a topic of Yes and No, which of both opens
ORDER_OPENS = {
    word + end: value
    for word, value in (("close", 0.0), ("grasp", 0.0), ("open", 1.0), ("release", 1.0))
    for end in ("", "_cmd", "_command")
}
TrackKind = Literal["command", "width", "effort"]


@dataclass(frozen=True)
class GripperTrack:
    """One number of a gripper over time: stamps, ns, rising, and values (n,).

    kind: what it is told, where it is, or how hard it presses.
    """

    topic: str
    kind: TrackKind
    times: NDArray[np.int64]
    values: Array

    def changes(self) -> list[tuple[int, int]]:
        """Start and end, ns, of each motion; of a command both are when it was given.

        Of what is called a width only those that make it smaller.
        """
        span = float(np.ptp(self.values)) if len(self.values) else 0.0
        if self.kind == "command":
            step = np.abs(np.diff(self.values)) > max(CHANGES_BY * span, 1e-6)
            # a topic of single commands; a stream of them begins with what holds already
            first = self.times[:1] if len(self.times) <= SINGLE else self.times[:0]
            given = [*first, *self.times[1:][step]]
            motions = _motions(self.times, self.values, span) if span > 1e-6 else []
            # a command may be a ramp of small steps
            given += [a for a, b in motions if not any(a <= t <= b for t in given)]
            return [(int(t), int(t)) for t in sorted(given)]
        if span < 1e-6 or _only_trembles(self.values, span):
            return []
        motions = _motions(self.times, self.values, span)
        if not any(word in self.topic.lower() for word in WIDTHS):
            return motions
        at = np.interp(np.array(motions).reshape(-1, 2), self.times, self.values)
        return [m for m, (before, after) in zip(motions, at, strict=True) if after < before]

    def openings(self) -> set[int]:
        """Those of `changes` by which a command opens the hand, by their start: to the largest of a
        width, to the No of a topic that is called close or grasp, the Yes of open or release.
        """
        order = ORDER_OPENS.get(_last(self.topic)) if {*self.values} <= {0.0, 1.0} else None
        is_width = any(word in _last(self.topic) for word in WIDTHS)
        widest = float(self.values.max(initial=-np.inf)) if is_width else None
        return self._changes_to(widest if order is None else order)

    def returns(self) -> set[int]:
        """Those of a stream of commands that go back to what it began with, by their start: an
        opening where the hand was open then, as it mostly is.
        """
        return self._changes_to(self.values[0] if len(self.values) > SINGLE else None)

    def _changes_to(self, value: float | None) -> set[int]:
        span = float(np.ptp(self.values)) if len(self.values) else 0.0
        if self.kind != "command" or value is None or span < 1e-6:
            return set()
        return {
            start
            for start, end in self.changes()
            if abs(float(np.interp(end, self.times, self.values)) - value) < OPENS_BY * span
        }

    def released_ns(self, close_ns: int, last_ns: int) -> int | None:
        """When the hand is told to open, or opens, after a close at a time, ns; None where it is
        not, or where that is not known.
        """
        span = float(np.ptp(self.values)) if len(self.values) else 0.0
        by = self.times <= close_ns + round(SETTLES_S * 1e9)
        if self.kind == "effort" or span < 1e-6 or not by.any():
            return None
        held = float(self.values[by][-1])
        later = (self.times > close_ns + round(SETTLES_S * 1e9)) & (self.times <= last_ns)
        apart = later & (np.abs(self.values - held) > RELEASED_BY * span)
        return int(self.times[apart][0]) if apart.any() else None


def _only_trembles(values: Array, span: float) -> bool:
    """Whether the steps between samples make up the range of a dense stream, as noise does."""
    return len(values) >= DENSE and span < TREMBLES * float(np.median(np.abs(np.diff(values))))


def _motions(times: NDArray[np.int64], values: Array, span: float) -> list[tuple[int, int]]:
    """Motions in one direction that cover enough of the range in time; their start is where they
    leave the level before."""
    rate = np.gradient(values, times * 1e-9) if len(times) > 2 else np.zeros(len(times))
    moving = np.abs(rate) > MOVES_BY * span / WITHIN_S
    out, k = [], 0
    while k < len(times):
        if not moving[k]:
            k += 1
            continue
        end = k
        while end + 1 < len(times) and moving[end + 1] and rate[end + 1] * rate[k] > 0:
            end += 1
        first, last = max(0, k - 1), min(len(times) - 1, end + 1)
        if abs(values[last] - values[first]) >= MOVES_BY * span:
            left = np.abs(values[first : last + 1] - values[first]) > 0.05 * span
            out.append((int(times[first + int(np.argmax(left))]), int(times[last])))
        k = end + 1
    return out


def is_gripper_topic(name: str, kind: str) -> bool:
    """Whether a topic is a gripper's, by its name and by its type."""
    has_word = any(word in name.lower() for word in GRIPPER_WORDS)
    has_word &= not any(word in _last(name) for word in NO_POSITION)
    parts = re.split(r"[/_]", name.lower())
    has_word &= not any(part in NOT_THE_HAND for part in parts)
    known = kind in (*NUMBERS, GOALS) or "ripper" in kind or kind.endswith("GraspActionGoal")
    known |= kind == BOOL and is_command_topic(name, kind)
    return has_word and known


def is_effort_topic(name: str) -> bool:
    """Whether a gripper's topic says how hard it presses."""
    return any(word in _last(name) for word in EFFORT_WORDS)


def _last(name: str) -> str:
    """The last part of a topic's name, in small letters."""
    return name.lower().rsplit("/", 1)[-1]


def is_command_topic(name: str, kind: str) -> bool:
    """Whether a gripper's topic says what it is told, and not where it is."""
    if kind == GOALS or (kind == BOOL and _last(name) in ORDERS):
        return True
    return any(word in _last(name) for word in COMMAND_WORDS) or any(
        kind.endswith(t) for t in COMMAND_TYPES
    )


def effort_track(name: str, rows: list[tuple[int, float]]) -> GripperTrack | None:
    """A joint's effort, each value the median of nine, so that noise moves nothing; None where it
    hardly changes against its noise.
    """
    if len(rows) < 3 * SMOOTHED:
        return None
    raw = np.array([v for _, v in rows])
    side = SMOOTHED // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(raw, side, mode="edge"), SMOOTHED)
    smooth = np.median(windows, axis=1)
    noise = float(np.median(np.abs(raw - smooth)))
    if float(np.ptp(smooth)) < max(OVER_NOISE * noise, 1e-6):
        return None
    times = np.array([t for t, _ in rows], dtype=np.int64)
    return GripperTrack(f"the effort of {name}", "effort", times, smooth)


def goals_of(message: Any, seen: set[bytes]) -> list[int]:
    """When each goal of an action that is not in `seen` was taken on, ns; `seen` grows by them."""
    out = []
    for status in message.status_list:
        key = np.asarray(status.goal_info.goal_id.uuid, dtype=np.uint8).tobytes()
        if key not in seen:
            seen.add(key)
            stamp = status.goal_info.stamp
            out.append(int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec))
    return out


def number_of(message: Any) -> float | None:
    """The number in a gripper's message; None where none is found."""
    for path in PATHS:
        value = message
        for name in path:
            value = getattr(value, name, None)
        if isinstance(value, int | float | np.number) and np.isfinite(value):
            return float(value)
    return None
