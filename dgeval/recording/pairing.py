"""Which colour and depth images belong together, and which of them lie in a trial's time window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config
from dgeval.errors import Damage, Place, UnreadableError, UsageError
from dgeval.recording.clocks import StampFaults, clean_stamps, pair, tolerance_ns
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.scan import Scan


class Pair(NamedTuple):
    """A colour and a depth image: the colour stamp, ns, and each one's ordinal in its topic."""

    t_ns: int
    colour: int
    depth: int


@dataclass(frozen=True)
class Pairing:
    """The usable images of a whole recording, and how they pair up.

    Stamps are ns, strictly rising, the role's clock offset added. indices: (index into colour_ns,
    index into depth_ns) of each pair, in time order. pairs: the same pairs by stamp and ordinals.
    faults: by role (`colour`, `depth`).
    """

    colour_ns: NDArray[np.int64]
    depth_ns: NDArray[np.int64]
    tolerance_ns: int
    indices: tuple[tuple[int, int], ...]
    pairs: tuple[Pair, ...]
    faults: dict[str, StampFaults]


@dataclass(frozen=True)
class Window:
    """One trial's share of a recording: its times (both inclusive, ns) and the pairs in it.

    Unmatched are usable images in the window without a partner near enough in time. stamp_faults
    count over the whole recording, by role.
    """

    start_ns: int
    end_ns: int
    pairs: tuple[Pair, ...]
    n_unmatched_colour: int
    n_unmatched_depth: int
    stamp_faults: dict[str, StampFaults]


def pair_images(scan: Scan, colour_topic: str, depth_topic: str, config: Config) -> Pairing:
    """Clean the stamps of both topics and pair their images by time."""
    jump_ns = round(config.sync.jump_s * 1e9)
    header, log = scan.times[colour_topic].arrays()
    colour_ns, colour_ordinals, colour_faults = clean_stamps(
        header, log, config.clock.colour.offset_ns, jump_ns
    )
    header, log = scan.times[depth_topic].arrays()
    depth_ns, depth_ordinals, depth_faults = clean_stamps(
        header, log, config.clock.depth.offset_ns, jump_ns
    )
    tolerance = tolerance_ns(colour_ns, config.sync)
    indices = pair(colour_ns, depth_ns, tolerance)
    pairs = tuple(
        Pair(int(colour_ns[c]), int(colour_ordinals[c]), int(depth_ordinals[d])) for c, d in indices
    )
    faults = {"colour": colour_faults, "depth": depth_faults}
    return Pairing(colour_ns, depth_ns, tolerance, tuple(indices), pairs, faults)


def window_of(pairing: Pairing, spec: TrialSpec, damage: list[Damage]) -> Window:
    """The window that a manifest entry asks for: by frames, by times, or the whole recording.

    UsageError for frames that are not there, UnreadableError where no pair lies in the window.
    """
    place = Place(str(spec.recording))
    colour_ns, depth_ns, pairs = pairing.colour_ns, pairing.depth_ns, pairing.pairs
    first, last = (int(colour_ns[0]), int(colour_ns[-1])) if len(colour_ns) else (0, 0)
    start = spec.start_ns if spec.start_ns is not None else first
    if spec.frames is not None:
        a, b = spec.frames
        if not 0 <= a < b <= len(pairs):
            raise UsageError(
                f"frames {a}:{b} are not within the recording's {len(pairs)} paired frames", place
            )
        pairs = pairs[a:b]
        start, end = pairs[0].t_ns, pairs[-1].t_ns
    else:
        end = spec.end_ns if spec.end_ns is not None else last
        pairs = tuple(p for p in pairs if start <= p.t_ns <= end)
    if not pairs:
        what = f"no colour and depth images pair up between {start} and {end} ns"
        if start > end:
            what = f"the trial's start is marked {(start - end) * 1e-9:.2f} s after its end: the "
            what += "clock was set back in between, as when a simulation starts again"
            raise UnreadableError(what, place, "record each run into a file of its own")
        if not pairing.pairs and len(colour_ns) and len(depth_ns):
            after = np.clip(np.searchsorted(depth_ns, colour_ns), 0, len(depth_ns) - 1)
            near = [
                np.abs(depth_ns[k] - colour_ns).min() for k in (after, np.maximum(after - 1, 0))
            ]
            apart = min(near) * 1e-6
            what += (
                f": {len(colour_ns)} colour and {len(depth_ns)} depth images, the nearest "
                f"{apart:.1f} ms apart, where {pairing.tolerance_ns * 1e-6:.1f} ms are allowed "
                "(sync.tolerance_s)"
            )
        if damage:
            what += f" (damage: {damage[0].what})"
        raise UnreadableError(what, place, "`dgeval inspect` lists each topic's rate and clock")
    n_colour = int(((colour_ns >= start) & (colour_ns <= end)).sum())
    n_depth = int(((depth_ns >= start) & (depth_ns <= end)).sum())
    return Window(
        start,
        end,
        pairs,
        max(0, n_colour - len(pairs)),
        max(0, n_depth - len(pairs)),
        pairing.faults,
    )


def stamp_notes(faults: dict[str, StampFaults]) -> list[str]:
    """A sentence on wrong stamps for the trial's notes; none where all were good."""
    late = [f"{f.late} {role}" for role, f in sorted(faults.items()) if f.late]
    put = [f"{' and '.join(late)} images were logged late, and are put in order"] if late else []
    if not any(f.dropped or f.zero for f in faults.values()):
        return put
    kinds = ("zero", "backward", "ahead", "duplicate")
    counted = ", ".join(
        f"{count} {kind} in {role}"
        for role, f in sorted(faults.items())
        for kind in kinds
        if (count := getattr(f, kind))
    )
    return [f"stamps: {counted}", *put]
