"""Catches: a team's own masks, boxes and poses replaced by what dgeval sees, taken of another
thing, or moved.

The marks are put into rendered frames of a box that slides, beside another thing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dgeval.geometry import Array, invert
from dgeval.recording.frame import Frame, MarkedThing
from dgeval.replay.causal import Step
from tests.perception.test_tracking import HALF, T_BASE_CAMERA, make, run, slide

N = 24
OTHER = (5.0, 5.0, 60.0, 60.0)  # px, of a thing that is not the target
UNSEEN = (10, 11, 12)  # frames in which the log marks nothing

Made = tuple[list[Frame], list[tuple[float, ...]]]


@pytest.fixture(scope="module")
def made() -> Made:
    return make(N, slide)


def T_camera_object(k: int) -> Array:
    return invert(T_BASE_CAMERA) @ slide(k)


def masked(frame: Frame, box: tuple[float, ...], name: str) -> MarkedThing:
    """The top face of the box, whose sides are seen too flat to be measured."""
    x0, y0, x1, y1 = (int(v) for v in box)
    rows, cols = np.mgrid[y0:y1, x0:x1]
    points = frame.camera.backproject(
        cols.ravel().astype(float),
        rows.ravel().astype(float),
        frame.depth[y0:y1, x0:x1].ravel().astype(np.float64),
    )
    height = (points @ T_BASE_CAMERA[:3, :3].T + T_BASE_CAMERA[:3, 3])[:, 2]
    return MarkedThing(box, name, height.reshape(rows.shape) > 2 * HALF[2] - 0.012)  # type: ignore[arg-type]


def marked(made: Made, things: object) -> list[Frame]:
    """The frames with things(k, frame, box) in all but UNSEEN."""
    frames, boxes = made
    return [
        f if k in UNSEEN else replace(f, marked=things(k, f, boxes[k]))  # type: ignore[operator]
        for k, f in enumerate(frames)
    ]


def drift(steps: list[Step]) -> Array:
    """(n,) m, of the box's own frame in the model's against that of the first frame."""
    out = []
    for k, step in enumerate(steps):
        if step.T_camera_model is not None and step.tracked.state == "tracked":
            out.append((invert(step.T_camera_model) @ T_camera_object(k))[:3, 3])
    return np.asarray(np.linalg.norm(np.array(out) - out[0], axis=1))


def test_masks_of_the_log_are_the_target(made: Made) -> None:
    """Fails where a mask is moved in its window, or what the log doesn't mark is followed."""
    frames = marked(made, lambda k, f, box: (masked(f, box, "m#2"),))
    steps = run(frames, made[1][0], "tracking.method=recorded")
    for k, step in enumerate(steps):
        if k in UNSEEN:
            assert step.tracked.state == "lost"
            assert step.tracked.box is None
            continue
        tracked, thing = step.tracked, frames[k].marked[0]
        assert (tracked.state, tracked.box) == ("tracked", thing.box)
        assert tracked.reacquired == (k - 1 in UNSEEN)
        seen = np.zeros(frames[k].depth.shape, dtype=bool)
        x0, y0, x1, y1 = tracked.window  # type: ignore[misc]
        seen[y0:y1, x0:x1] = tracked.mask
        x0, y0, x1, y1 = (int(v) for v in thing.box)
        inside, own = seen[y0:y1, x0:x1], thing.pixels & (frames[k].depth[y0:y1, x0:x1] > 0)
        assert int(seen.sum()) == int(inside.sum()) == tracked.mask_area, "pixels beside its box"
        assert not (inside & ~own).any()
        assert inside.sum() > (0.9 if k else 0.999) * own.sum()
    assert sum(step.accepted for step in steps) >= 15
    assert np.median(drift(steps)) < 0.003


def test_the_named_thing_is_followed_past_another(made: Made) -> None:
    """Fails where the first thing, or the one at the last place, is taken in spite of its name."""

    def things(k: int, frame: Frame, box: tuple[float, ...]) -> tuple[MarkedThing, ...]:
        there = made[1][k - 1] if k else OTHER  # the other one is where the target was before
        other = MarkedThing(there, "other", score=0.9)  # type: ignore[arg-type]
        return other, MarkedThing(box, "target", score=0.4)  # type: ignore[arg-type]

    steps = run(marked(made, things), made[1][0], "tracking.method=recorded")
    for k, step in enumerate(steps):
        assert step.tracked.box == (None if k in UNSEEN else made[1][k])
        assert step.tracked.confidence == (None if k in UNSEEN else 0.4)
    assert sum(step.accepted for step in steps) >= 15


def test_boxes_without_names_are_told_by_their_place(made: Made) -> None:
    """Fails where the first of several detections is taken."""
    frames = marked(
        made,
        lambda k, f, box: (MarkedThing(OTHER), MarkedThing(box)),  # type: ignore[arg-type]
    )
    steps = run(frames, made[1][0], "tracking.method=recorded")
    assert [s.tracked.box for k, s in enumerate(steps) if k not in UNSEEN] == [
        box for k, box in enumerate(made[1]) if k not in UNSEEN
    ]


@pytest.mark.parametrize("off_m", [0.0, 0.03])
def test_a_recorded_pose_is_not_moved(made: Made, off_m: float) -> None:
    """Fails where registration pulls a recorded pose to what dgeval sees, or its gate replaces it
    by a prediction: 30 mm beside the object from frame 5 on.
    """

    def at(k: int, frame: Frame, box: tuple[float, ...]) -> tuple[MarkedThing, ...]:
        T = T_camera_object(k).copy()
        T[0, 3] += off_m * (k >= 5)
        u, v = frame.camera.project(T[None, :3, 3])[0]
        near = (u - 20, v - 20, u + 20, v + 20)
        return (MarkedThing(near, "/pose", T_camera_object=T, is_point=True),)

    settings = ("tracking.method=recorded", "estimation.null_after_s=0.2")
    steps = run(marked(made, at), made[1][0], *settings)
    errors = drift(steps)
    n_before = 5
    assert errors[:n_before].max() < 1e-9
    assert np.abs(errors[n_before:] - off_m).max() < 1e-9
    assert len(errors) == N - len(UNSEEN), "its pose is told for as long as the log has it"
    accepted = [s.accepted for k, s in enumerate(steps) if k not in UNSEEN]
    assert all(accepted[:n_before])
    # the gate still says that depth does not show the object there
    assert any(accepted[n_before:]) == (off_m == 0.0)
    for k, step in enumerate(steps):
        assert (step.tracked.state == "tracked") == (k not in UNSEEN)


def test_without_a_mark_nothing_is_followed(made: Made) -> None:
    frames, boxes = made
    steps = run(frames, boxes[0], "tracking.method=recorded")
    assert {s.tracked.state for s in steps} == {"lost"}
    assert all(s.model is None for s in steps)


def test_a_number_of_the_entries_is_no_name(made: Made) -> None:
    """Fails where a detector's ids are the entries' numbers, and another thing is followed once
    their order changes; and where one name stands for several things.
    """

    def numbered(k: int, frame: Frame, box: tuple[float, ...]) -> tuple[MarkedThing, ...]:
        order = (OTHER, box) if k < 6 else (box, OTHER)
        return tuple(MarkedThing(b, f"id#{n}") for n, b in enumerate(order))  # type: ignore[arg-type]

    def alike(k: int, frame: Frame, box: tuple[float, ...]) -> tuple[MarkedThing, ...]:
        return MarkedThing(OTHER, "ball"), MarkedThing(box, "ball")  # type: ignore[arg-type]

    for things in (numbered, alike):
        steps = run(marked(made, things), made[1][0], "tracking.method=recorded")
        assert [s.tracked.box for k, s in enumerate(steps) if k not in UNSEEN] == [
            box for k, box in enumerate(made[1]) if k not in UNSEEN
        ]
