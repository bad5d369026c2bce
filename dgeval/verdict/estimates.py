"""What a trial shows of a described hand that other trials of the hand don't, and its use there.

A trial's verdict never asks the other trials of its run: what these show is put together when all
are done, and given to a run as an input.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dgeval.geometry import Array
from dgeval.hindsight.second_pass import Hindsight
from dgeval.robots.described_hand import DescribedHand
from dgeval.robots.hand import Hand
from dgeval.verdict.evidence import Scene, scene_of
from dgeval.verdict.log import HandEstimate, TrialLog
from dgeval.verdict.outcome import Ended, empty_fingers
from dgeval.verdict.recorded_closing import Closing


@dataclass(frozen=True)
class HandShown:
    """What one trial shows of its hand, by its joints (k,), rad or m.

    key: of the hand's joints. spans (k,): their ranges. closing: as recorded. empty (k,): where
    they came to rest with nothing between the fingers, by what is not read from the fingers.
    """

    key: str
    told: str
    joints: tuple[str, ...]
    spans: Array
    closing: Closing | None
    empty: Array | None


@dataclass(frozen=True)
class Estimates:
    """Of each hand, by its key, what a set of trials shows; sha256: of the file."""

    hands: Mapping[str, HandEstimate]
    sha256: str

    def of(self, hand: Hand | str) -> HandEstimate | None:
        """Of a hand; None where dgeval knows it by name, or no trial shows it."""
        return self.hands.get(hand.geometry.key) if isinstance(hand, DescribedHand) else None


def hand_shown(
    log: TrialLog, hindsight: Hindsight | None, ended: Ended, scene: Scene | None
) -> HandShown | None:
    """What the trial shows of a described hand; None where it shows nothing.

    scene: where the verdict has made one already.
    """
    hand = log.robot.hand_found
    if not isinstance(hand, DescribedHand) or log.close_ns is None:
        return None
    if scene is None and hindsight is not None:
        made = scene_of(log, hindsight)
        scene = made if isinstance(made, Scene) else None
    closing = None if scene is None else scene.closing
    empty = empty_fingers(log, hand, ended)
    if closing is None and empty is None:
        return None
    geometry = hand.geometry
    return HandShown(geometry.key, hand.told, geometry.names, geometry.spans, closing, empty)
