"""Catches: a target that is lost for good, a hand taken for it, and one thing taken for another.

On rendered frames with exact truth: something hides the target, touches it, or takes its place.
"""

from __future__ import annotations

import numpy as np
import pytest
from dgeval.geometry import Intrinsics
from dgeval.perception.appearance import Appearance, Colours
from dgeval.perception.redetection import look_alikes
from dgeval.recording.frame import Frame
from dgeval.replay.causal import Step
from numpy.typing import NDArray
from tests.perception.test_tracking import (
    CAMERA,
    HALF,
    PERIOD_NS,
    T_BASE_CAMERA,
    at,
    run,
    world,
)

from raycast import Box, Capsule, add_noise, printed, render

Solids = list[tuple[Box | Capsule, np.ndarray]]
TARGET = at(-0.05, -0.2, HALF[2], 0.4)


def filmed(scenes: list[Solids]) -> tuple[list[Frame], list[NDArray[np.bool_]]]:
    """Frames of solids on the table under a resting camera, and where the first one is seen."""
    rng = np.random.default_rng(1)
    scene, _ = world()
    frames, seen = [], []
    for k, solids in enumerate(scenes):
        scene.solids = solids
        colour, depth, ids = render(scene, CAMERA, T_BASE_CAMERA)
        seen.append(ids == 0)
        colour, millimetres = add_noise(rng, colour, depth)
        metres = millimetres.astype(np.float32) * np.float32(0.001)
        frames.append(Frame(k, 10**15 + k * PERIOD_NS, colour, metres, CAMERA, T_BASE_CAMERA, None))
    return frames, seen


def box_of(seen: NDArray[np.bool_]) -> tuple[float, ...]:
    v, u = np.nonzero(seen)
    return float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1)


def overlap(step: Step, seen: NDArray[np.bool_]) -> float:
    """Of the tracked box and the true one; 0 where nothing is tracked."""
    if step.tracked.box is None:
        return 0.0
    a, b = step.tracked.box, box_of(seen)
    w, h = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    both = max(0.0, w) * max(0.0, h)
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)


@pytest.fixture(scope="module")
def hidden() -> tuple[list[NDArray[np.bool_]], list[Step]]:
    """A screen before the target in frames 10 to 24; then the target lies 14 cm further on."""
    _, box = world()
    screen = Box((0.10, 0.09, 0.01), [printed(np.random.default_rng(5), (200, 190, 180))] * 6)
    over = at(-0.05, -0.16, 0.20)
    moved = at(0.09, -0.2, HALF[2], 0.7)
    scenes: list[Solids] = [[(box, TARGET)] for _ in range(10)]
    scenes += [[(box, TARGET), (screen, over)] for _ in range(15)]
    scenes += [[(box, moved)] for _ in range(15)]
    frames, seen = filmed(scenes)
    return seen, run(frames, box_of(seen[0]))


def test_what_hides_the_target_is_told_and_not_tracked(hidden: object) -> None:
    """Fails where the screen becomes the target, or its loss has no reason."""
    _, steps = hidden  # type: ignore[misc]
    behind = [s.tracked for s in steps[12:24]]
    assert all(t.state == "lost" and t.occluded for t in behind)
    assert all(t.confidence == 0.0 for t in behind)


def test_a_target_that_comes_back_elsewhere_is_found_again(hidden: object) -> None:
    """Fails where it is looked for where it was lost only, or its model can't be put there."""
    seen, steps = hidden  # type: ignore[misc]
    assert [overlap(s, m) > 0.7 for s, m in zip(steps[28:], seen[28:], strict=True)] == [True] * 12
    assert [k for k, s in enumerate(steps) if s.tracked.reacquired and k > 24] == [25]
    assert all(s.accepted for s in steps[30:])
    assert min(s.tracked.confidence for s in steps[30:]) > 0.8


def test_a_finger_of_nobody_s_robot_stays_out_of_the_mask() -> None:
    """Fails where depth alone decides: the finger lies against the target, as deep as it is."""
    _, box = world()
    skin = Capsule(0.014, 0.06, (224, 172, 140))
    scenes: list[Solids] = []
    for k in range(30):
        side = at(-0.05 + HALF[0] + 0.10 - min(0.004 * k, 0.085), -0.2, 0.06)
        scenes.append([(box, TARGET), (skin, side)])
    frames, seen = filmed(scenes)
    steps = run(frames, box_of(seen[0]))
    for step, target in zip(steps, seen, strict=True):
        assert step.tracked.mask is not None
        assert step.tracked.window is not None
        x0, y0, x1, y1 = step.tracked.window
        wrong = step.tracked.mask & ~target[y0:y1, x0:x1]
        assert wrong.sum() < 0.06 * step.tracked.mask.sum()


def test_another_thing_in_its_place_is_not_the_target() -> None:
    """Fails where the shape alone decides: a box of equal size is put where the target was."""
    _, box = world()
    other = Box(HALF, [printed(np.random.default_rng(9), (40, 150, 60)) for _ in range(6)])
    scenes: list[Solids] = [[(box, TARGET)] for _ in range(8)]
    scenes += [[(other, TARGET)] for _ in range(8)]
    frames, seen = filmed(scenes)
    steps = run(frames, box_of(seen[0]))
    assert all(s.tracked.state == "tracked" for s in steps[:8])
    assert not any(s.accepted for s in steps[8:])
    assert all(s.tracked.state == "lost" for s in steps[8:])


def patches(target: tuple[int, int, int], rest: tuple[int, int, int]) -> NDArray[np.uint8]:
    """An image with a square of one colour, with a mark 4 px wide of the other one in it."""
    image = np.full((120, 160, 3), rest, np.uint8)
    image[40:80, 60:100] = target
    image[58:62, 65:95] = rest
    return image


def learnt(image: NDArray[np.uint8]) -> Appearance:
    camera = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0)
    looks = Appearance()
    window = (55, 35, 105, 85)
    mask = np.zeros((50, 50), dtype=bool)
    mask[5:45, 5:45] = True
    looks.start(Colours(image), (60.0, 40.0, 100.0, 80.0), window, mask, camera)
    return looks


def test_a_mark_on_the_target_in_the_colour_of_the_table_is_the_target_s() -> None:
    """Fails where print is cut out of the mask: what is left is a worse shape."""
    image = patches((200, 30, 30), (120, 110, 100))
    looks = learnt(image)
    assert looks.separable_near > 0.6
    unlike = looks.unlike(Colours(image), (55, 35, 105, 85))
    assert not unlike[5:45, 5:45].any()
    image[40:60, 60:100] = (120, 110, 100)  # half of the target is behind something
    assert looks.unlike(Colours(image), (55, 35, 105, 85))[8:20, 8:40].all()


def test_colours_that_tell_nothing_are_not_used() -> None:
    """Fails where a white cup on a white table loses its pixels to the table."""
    image = patches((122, 111, 101), (120, 110, 100))
    looks = learnt(image)
    assert looks.separable_near < 0.6
    assert not looks.unlike(Colours(image), (55, 35, 105, 85)).any()


def test_the_first_mask_keeps_half_of_the_weight() -> None:
    """Fails where a hand that is learnt for long enough becomes the target."""
    image = patches((200, 30, 30), (120, 110, 100))
    looks = learnt(image)
    camera = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0)
    window, mask = (5, 5, 25, 25), np.ones((20, 20), dtype=bool)
    image[5:25, 5:25] = (30, 30, 200)
    for _ in range(200):
        looks.learn(Colours(image), (5.0, 5.0, 25.0, 25.0), window, mask, camera)
    assert looks.alike(
        Colours(image), (60, 40, 100, 58), np.ones((18, 40), dtype=bool)
    ) == pytest.approx(np.sqrt(0.5), abs=0.05)


def test_the_camera_s_pose_is_not_needed_to_find_the_target_again() -> None:
    """Fails where the search needs the base frame."""
    _, box = world()
    scenes: list[Solids] = [[(box, TARGET)] for _ in range(8)]
    scenes += [[] for _ in range(4)]
    scenes += [[(box, at(0.09, -0.2, HALF[2], 0.4))] for _ in range(6)]
    frames, seen = filmed(scenes)
    blind = [Frame(f.index, f.t_ns, f.colour, f.depth, f.camera, None, None) for f in frames]
    steps = run(blind, box_of(seen[0]))
    assert all(s.tracked.state == "lost" for s in steps[8:12])
    assert all(overlap(s, m) > 0.7 for s, m in zip(steps[13:], seen[13:], strict=True))


def test_a_few_readings_of_what_is_behind_do_not_make_the_target_too_large() -> None:
    """Fails where a target without depth, in full view, is lost by stray readings around it."""
    _, box = world()
    near = at(-0.02, -0.16, 0.36, 0.4)
    scenes: list[Solids] = [[(box, TARGET)] for _ in range(8)]
    scenes += [[(box, near)] for _ in range(6)]
    frames, seen = filmed(scenes)
    for k in range(8, 14):
        v, u = np.nonzero(seen[k])
        frames[k].depth[v, u] = 0.0
        frames[k].depth[v[::20], u[::20]] = 0.75  # of the table behind it
    steps = run(frames, box_of(seen[0]))
    assert [overlap(s, m) > 0.6 for s, m in zip(steps[8:], seen[8:], strict=True)] == [True] * 6
    assert not any(s.accepted for s in steps[8:])


@pytest.mark.parametrize("with_depth", [0, 10, 20, 24, 40])
def test_a_small_look_alike_with_some_depth_is_weighed(with_depth: int) -> None:
    """Fails where a thing of some 40 px has depth in half of them, and too few for a distance."""
    image = patches((200, 30, 30), (120, 110, 100))
    looks = learnt(image)
    other = np.full_like(image, (120, 110, 100))
    other[20:26, 20:28] = (200, 30, 30)
    depth = np.zeros((120, 160), np.float32)
    v, u = np.nonzero((other == (200, 30, 30)).all(axis=2))
    depth[v[:with_depth], u[:with_depth]] = 1.0
    camera = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0)
    frame = Frame(1, 1, other, depth, camera, None, None)
    found = look_alikes(
        looks, frame, Colours(other), np.zeros(depth.shape, dtype=bool), 48 / 150**2, 1.0
    )
    assert len(found) == 1
