"""The events of one trial: what the robot or an operator wrote about it while it ran."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from dgeval.recording.contract import (
    LABEL_EVENT,
    LABEL_KEYS,
    NOTES_KEY,
    TRIAL_START_EVENT,
    EventKind,
    label_of,
)
from dgeval.recording.messages import Event

AFTER_NS = 1_000_000_000  # ns; events this long after a trial's last frame still belong to it
PRESSED_AGAIN_NS = 2_000_000_000  # ns, in which no trial begins and ends; ours
SAME_EVENT_NS, MOST_AT_ONCE = 50_000_000, 8  # ns, and events before, that may be the same; ours


@dataclass(frozen=True)
class Events:
    """The entries of a trial in time order."""

    entries: tuple[Event, ...] = ()

    def __iter__(self) -> Iterator[Event]:
        return iter(self.entries)

    def first_ns(self, kind: EventKind) -> int | None:
        """Time of the first event of a kind, ns; None without one."""
        return next((e.t_ns for e in self.entries if e.kind == kind), None)

    def labels(self) -> list[tuple[Event, object]]:
        """Each label with what it holds, as written; None where it holds nothing."""
        out: list[tuple[Event, object]] = []
        for event in self.entries:
            said = [event.fields[k] for k in LABEL_KEYS if k in event.fields]
            if is_label(event):
                out.append((event, said[0] if said else None))
        return out

    def label(self) -> Literal["success", "failure"] | None:
        """What the labels that can be read say; None where they contradict each other."""
        said = {known for _, text in self.labels() if (known := label_of(text))}
        return said.pop() if len(said) == 1 else None

    def notes(self) -> list[str]:
        """What the entries at the trial's start say about how it was recorded."""
        out: list[str] = []
        for event in self.entries:
            listed = event.fields.get(NOTES_KEY)
            if event.kind == TRIAL_START_EVENT and isinstance(listed, list):
                out.extend(str(note) for note in listed)
        return out


def heard_once(events: Iterable[Event]) -> list[Event]:
    """In time order, each of those that two recorders wrote once."""
    out: list[Event] = []
    for event in sorted(events, key=lambda e: e.t_ns):
        just_before = [e for e in out[-MOST_AT_ONCE:] if event.t_ns - e.t_ns <= SAME_EVENT_NS]
        if not any((e.kind, e.fields) == (event.kind, event.fields) for e in just_before):
            out.append(event)
    return out


def pressed_once(events: Iterable[Event]) -> list[Event]:
    """Without the starts of trials that come soon after another one, with nothing in between: a
    person has pressed twice.
    """
    out: list[Event] = []
    for event in sorted(events, key=lambda e: e.t_ns):
        again = bool(out) and out[-1].kind == event.kind == TRIAL_START_EVENT
        if not (again and event.t_ns - out[-1].t_ns < PRESSED_AGAIN_NS):
            out.append(event)
    return out


def started_twice(events: Iterable[Event], start_ns: int, end_ns: int) -> list[str]:
    """A note where several starts lie in a trial's window, ns; none without."""
    starts = [
        e.t_ns for e in events if e.kind == TRIAL_START_EVENT and start_ns <= e.t_ns <= end_ns
    ]
    if len(starts) < 2:
        return []
    apart = (max(starts) - min(starts)) * 1e-9
    return [f"trial_start is marked {len(starts)} times within {apart:.2f} s: taken for one"]


def is_label(event: Event) -> bool:
    """Whether an event says how the trial ended, whatever it is called."""
    return event.kind == LABEL_EVENT or any(key in event.fields for key in LABEL_KEYS)


def events_within(
    events: list[Event],
    start_ns: int,
    end_ns: int,
    limit_ns: int | None,
    next_ns: int | None = None,
) -> Events:
    """The events of a window, ns, and of AFTER_NS after it, but none after `limit_ns`.

    Labels come later, when an operator has looked: all up to the next trial's start. next_ns: of
    that, where nobody marked it.
    """
    last_ns = end_ns + AFTER_NS if limit_ns is None else min(end_ns + AFTER_NS, limit_ns)
    starts = [e.t_ns for e in events if e.kind == TRIAL_START_EVENT and e.t_ns > end_ns]
    starts += [] if next_ns is None else [next_ns]

    def belongs(event: Event) -> bool:
        is_late_label = is_label(event) and (not starts or event.t_ns < min(starts))
        return start_ns <= event.t_ns and (event.t_ns <= last_ns or is_late_label)

    return Events(tuple(e for e in events if belongs(e)))
