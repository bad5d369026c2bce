"""The standing evaluation of verdicts, on few small trials, from simulation to tables.

Catches: a condition that simulates again or leaves in what it takes away, a stopped evaluation that
begins anew, and verdicts set against another trial's truth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from dgeval.config import load_config
from dgeval.evaluate import verdicts
from dgeval.evaluate.agreement import document_of
from dgeval.evaluate.verdicts import LABELLED, RECORDED, VerdictArm, arms_of, run_arm
from dgeval.recording.containers.opening import open_container
from dgeval.simulation import campaign


def test_the_arms() -> None:
    """Catches an arm as modelled, trials chosen by their outcome, and a hand without its meshes."""
    own = arms_of([])
    assert [arm.name for arm in own] == ["failures", "handover"]
    assert all(arm.scenario.physics is not None and arm.scenario.choose is None for arm in own)
    assert own[0].config == load_config("dynamic")
    assert own[1].config == load_config("handover")


@pytest.mark.slow
def test_a_slice_from_simulation_to_judgement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = arms_of([])[0]
    camera = arm.scenario.camera.model_copy(update={"width": 320, "height": 240, "rate": 15.0})
    arm = VerdictArm(arm.name, arm.scenario.model_copy(update={"camera": camera}))
    told: list[tuple[str, int, int]] = []

    conditions = (RECORDED, LABELLED)

    def judged() -> list[verdicts.Judged]:
        return run_arm(
            arm,
            conditions,
            5,
            2,
            None,
            tmp_path,
            1,
            lambda phase, k, n, _: told.append((phase, k, n)),
        )

    first = judged()
    assert [(t.condition, t.trial) for t in first] == [
        (c, name) for c in conditions for name in ("sugar_box-000-0000", "pudding_box-000-0001")
    ]
    assert told[-2:] == [("judge, labelled", 1, 2), ("judge, labelled", 2, 2)]
    by = {(t.condition, t.trial): t for t in first}
    for t in first:
        assert t.said is not None, t.messages
        assert t.said["trial"] == t.trial
        assert (t.said["outcome_source"] == "label") == (t.condition == "labelled")
        if t.condition == "labelled":
            assert t.outcome == t.true["outcome"]
    # of a stranger's log the close is found by the fingers
    held = by["labelled", "pudding_box-000-0001"]
    assert held.true["t_close_ns"] is not None
    assert held.said is not None
    assert abs(held.said["t_close_ns"] - held.true["t_close_ns"]) < 50_000_000
    assert by["recorded", "pudding_box-000-0001"].said["close_source"] == "event"  # type: ignore[index]
    name = "pudding_box-000-0001.mcap"
    full = open_container(tmp_path / "failures" / name)
    bare = open_container(tmp_path / "failures" / "stranger" / name)
    own = {topic for topic in full.topics if topic.startswith(("/dgeval/", "/truth/"))}
    assert own
    assert bare.topics == {k: v for k, v in full.topics.items() if k not in own} or (
        set(bare.topics) == set(full.topics) - own
    )
    kept = frozenset(bare.topics)
    assert [(m.topic, m.log_ns, m.data) for m in bare.messages(kept)] == [
        (m.topic, m.log_ns, m.data) for m in full.messages(kept)
    ]

    def never(*_: Any) -> None:
        raise AssertionError("it was simulated again")

    monkeypatch.setattr(campaign, "_proved", never)
    again = judged()
    assert document_of(again) == document_of(first)
