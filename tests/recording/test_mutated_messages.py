"""Catches: a changed byte in a message that ends in anything but dgeval's own error, or that harms
the frames of other messages. A slice of `python -m tests.soak.mutated_messages`.
"""

from __future__ import annotations

import pytest
from tests.soak.mutated_messages import CASES, fault, frames_of


@pytest.mark.parametrize("name", sorted(CASES))
def test_a_changed_message_costs_no_more_than_itself(name: str) -> None:
    made = CASES[name]()
    whole = frames_of(made)
    assert len(whole) == 6
    assert [what for seed in range(25) if (what := fault(made, whole, seed, "later" in name))] == []
