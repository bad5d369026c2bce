"""Catches: a depth image used twice, pairs beyond the tolerance, wrong stamps not counted."""

from __future__ import annotations

import numpy as np
from dgeval.config import SyncConfig
from dgeval.recording.clocks import clean_stamps, pair, tolerance_ns
from hypothesis import given
from hypothesis import strategies as st

rising = st.lists(st.integers(1, 100), max_size=25).map(
    lambda steps: np.cumsum(np.array(steps, dtype=np.int64))
)


@given(rising, rising, st.integers(0, 60))
def test_pairs_are_one_to_one_in_order_and_within_tolerance(
    c: np.ndarray, d: np.ndarray, tolerance: int
) -> None:
    """Fails where an image is in two pairs, or a pair is farther apart than the tolerance."""
    pairs = pair(c, d, tolerance)
    assert len({a for a, _ in pairs}) == len({b for _, b in pairs}) == len(pairs)
    assert pairs == sorted(pairs)
    for a, b in pairs:
        assert abs(int(c[a]) - int(d[b])) <= tolerance


@given(rising)
def test_equal_stamps_pair_completely(c: np.ndarray) -> None:
    """Fails where a neighbour is preferred to an exact match."""
    assert pair(c, c, 10) == [(i, i) for i in range(len(c))]


def test_the_nearest_wins_and_the_other_stays_alone() -> None:
    """Fails where images are paired first come, first served."""
    assert pair(np.array([0, 10]), np.array([9]), 20) == [(1, 0)]


def test_half_rate_depth_leaves_every_second_colour_unmatched() -> None:
    """Fails where one depth image serves two colour images."""
    colour = np.arange(10) * 33
    assert len(pair(colour, colour[::2], 16)) == 5


def test_stamp_faults_follow_their_rules() -> None:
    """Fails where a wrong stamp is used, dropped or counted against its rule."""
    header = np.array([10, 20, 0, 15, 30, 30, 10_000_000_000_040], dtype=np.int64)
    log = np.array([11, 21, 26, 31, 32, 33, 41], dtype=np.int64)
    stamps, ordinals, faults = clean_stamps(header, log, 0, 5_000_000_000)
    assert stamps.tolist() == [10, 20, 26, 30, 10_000_000_000_040]
    assert ordinals.tolist() == [0, 1, 2, 4, 6]
    assert (faults.zero, faults.backward, faults.duplicate, faults.jump) == (1, 1, 1, 1)


def test_clock_offset_is_added() -> None:
    """Fails where the clock offset is subtracted or left out."""
    stamps, _, _ = clean_stamps(np.array([10, 20]), np.array([10, 20]), -3, 10**9)
    assert stamps.tolist() == [7, 17]


def test_default_tolerance_is_half_a_period() -> None:
    """Fails where slow cameras pair images 50 ms apart, or a configured value is not used."""
    assert tolerance_ns(np.arange(5) * 33_000_000, SyncConfig()) == 16_500_000
    assert tolerance_ns(np.arange(5) * 10**9, SyncConfig()) == 50_000_000
    assert tolerance_ns(np.arange(5), SyncConfig(tolerance_s=0.01)) == 10_000_000


PERIOD_NS = 66_000_000


def test_messages_that_a_network_delayed_are_put_in_order() -> None:
    """Fails where what is logged late is dropped although its stamp is right."""
    stamps = np.arange(1, 70, dtype=np.int64) * PERIOD_NS
    delays = np.random.default_rng(0).integers(0, 400_000_000, 69)
    order = np.argsort(stamps + delays)
    used, ordinals, faults = clean_stamps(stamps[order], (stamps + delays)[order], 0, 10**12)
    assert used.tolist() == stamps.tolist()
    assert order[ordinals].tolist() == list(range(69))
    assert faults.dropped == 0
    assert faults.late > 20


def test_a_clock_that_is_set_back_is_not_put_in_order() -> None:
    """Fails where pictures before and after the step are mixed."""
    log = np.arange(1, 101, dtype=np.int64) * PERIOD_NS
    stamps = log - np.where(np.arange(100) < 60, 0, 500_000_000)
    _, ordinals, faults = clean_stamps(stamps, log, 0, 10**12)
    assert faults.late == 0
    assert (np.diff(ordinals) > 0).all()


def test_one_wrong_stamp_among_right_ones_is_dropped() -> None:
    """Fails where it is taken for a message that was logged late: nothing is missing there."""
    log = np.arange(1, 101, dtype=np.int64) * PERIOD_NS
    stamps = log.copy()
    stamps[50] -= 5 * PERIOD_NS + 10_000_000
    _, ordinals, faults = clean_stamps(stamps, log, 0, 10**12)
    assert (faults.late, faults.backward) == (0, 1)
    assert 50 not in ordinals
