"""Catches: an error of the robot's belief with a wrong sign, size, frame or time, and one told
without its evidence.

`beliefs_of` on a trial made of numbers (synthetic_trial.py) into which known errors were put.
Nothing is simulated. The camera rides on a hand at constant twist, and the robot's model frame is
not hindsight's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dgeval.config import Config
from dgeval.failure_rule import Unknown
from dgeval.geometry import Array, invert, transform
from dgeval.recording.messages import StampedPose
from dgeval.verdict.beliefs import (
    Beliefs,
    beliefs_of,
    carried,
    gains_of,
    growth,
    laid_on,
    steady,
)
from dgeval.verdict.log import log_of
from tests.verdict.synthetic_trial import (
    CENTRE,
    COMMAND,
    GRASP,
    HALF,
    OBJECT_VELOCITY,
    SIGHTED,
    T_MODEL_OWN,
    T_OBJECT_MODEL,
    TARGET,
    VELOCITY,
    believed,
    box_at,
    box_grid,
    every,
    hand_poses,
    hindsight_of,
    own_model,
    palm_at,
    shift,
    sighted,
    stamped,
    trial_of,
    turn,
    twist,
)

SMOOTHED = 5e-6  # m; more than the smoother's prior takes off a velocity, within a second or two
SERVO = np.array([0.004, -0.007, 0.011])  # m, the palm off its grasp
START, DRIFT = np.array([0.006, -0.004, 0.005]), np.array([0.002, 0.004, -0.003])  # m, m/s
BELIEVED = OBJECT_VELOCITY + np.array([0.03, -0.02, 0.01])  # m/s
FIRST, LAST = -1.5, -0.3  # s, of the robot's own sightings
OWN = every(0.1, FIRST, LAST)
WILD = np.array([0.3, 0.3, 0.3])


def error_at(t: float) -> Array:
    return START + DRIFT * (t - FIRST)


def beliefs(trial: Any, hindsight: Any = None) -> Beliefs:
    found = beliefs_of(log_of(trial), hindsight_of() if hindsight is None else hindsight)
    assert isinstance(found, Beliefs), found
    return found


def grasp_for(t: float, apart: Array = SERVO) -> StampedPose:
    """A grasp from which the palm is so far off then."""
    return stamped(t, shift(-apart) @ palm_at(t))


def believing_trial(**changed: Any) -> Any:
    """A closed trial with all errors in it. Whatever comes after the close is far off, and so are
    predictions.
    """
    grasp = stamped(-0.02, shift(-SERVO - BELIEVED * 0.02) @ palm_at(0.0))
    targets = [believed(t, error_at(t)) for t in OWN]
    predictions = [believed(t, WILD) for t in (-0.2, -0.1, 0.3)]
    given: dict[str, Any] = {
        "poses": {
            GRASP: [grasp_for(-1.0, WILD), grasp, grasp_for(0.1, WILD)],
            TARGET: [*targets, *predictions],
        },
        "twists": {VELOCITY: [twist(-1.0, WILD), twist(-0.05, BELIEVED), twist(0.05, WILD)]},
        "masks": [*OWN, 0.3],
    }
    return trial_of(**{**given, **changed})


# the errors at a close


@pytest.mark.parametrize("modelled", [False, True])
def test_errors_that_were_put_in_are_found(modelled: bool) -> None:
    """Catches signs, frames of camera and model mixed up, and errors that are not carried on to the
    close.

    Without the robot's own model the error that it had from the start can't be seen.
    """
    found = beliefs(believing_trial(models=[(FIRST, own_model())] if modelled else []))
    assert set(found.errors) == {"servo", "tracking", "velocity"}
    np.testing.assert_allclose(found.errors["servo"], SERVO, atol=1e-8)
    sighted_last = START * modelled + DRIFT * (LAST - FIRST)
    tolerance = 0.001 if modelled else SMOOTHED  # of laying surfaces
    np.testing.assert_allclose(
        found.errors["tracking"], sighted_last + DRIFT * -LAST, atol=tolerance
    )
    wrong = (BELIEVED - OBJECT_VELOCITY - DRIFT) * -LAST
    np.testing.assert_allclose(found.errors["velocity"], wrong, atol=SMOOTHED)


def test_a_drift_is_that_of_the_last_second() -> None:
    """Catches a growth over all sightings: before the last second the errors were others."""
    targets = [believed(t, error_at(t) if t == FIRST or t >= LAST - 1.001 else WILD) for t in OWN]
    poses = {**believing_trial().scan.poses, TARGET: targets}
    found = beliefs(believing_trial(poses=poses))
    np.testing.assert_allclose(
        found.errors["tracking"], DRIFT * (LAST - FIRST - LAST), atol=SMOOTHED
    )


def test_a_sighting_from_an_unknown_place_tells_no_drift() -> None:
    """Catches an exception where the camera's pose is not known for a while."""
    hands = hand_poses([t for t in every(0.02, -2.0, 1.0) if not -0.88 < t < -0.32])
    expected = DRIFT * (LAST - FIRST - LAST)
    found = beliefs(believing_trial(hands=hands)).errors
    np.testing.assert_allclose(found["tracking"], expected, atol=SMOOTHED)


def test_four_sightings_tell_no_drift() -> None:
    """Catches a growth by a line through too little."""
    own = [FIRST, -0.5, -0.4, LAST]
    poses = {**believing_trial().scan.poses, TARGET: [believed(t, error_at(t)) for t in own]}
    found = beliefs(believing_trial(poses=poses, masks=own))
    np.testing.assert_allclose(found.errors["tracking"], DRIFT * (LAST - FIRST), atol=SMOOTHED)
    np.testing.assert_allclose(
        found.errors["velocity"], (BELIEVED - OBJECT_VELOCITY) * -LAST, atol=SMOOTHED
    )


def test_without_a_believed_velocity_nothing_is_carried() -> None:
    """Catches a velocity of zero taken for a belief."""
    found = beliefs(believing_trial(twists={}))
    assert set(found.errors) == {"servo", "tracking"}
    np.testing.assert_allclose(found.errors["servo"], SERVO + BELIEVED * 0.02, atol=1e-8)
    np.testing.assert_allclose(found.errors["tracking"], DRIFT * (LAST - FIRST), atol=SMOOTHED)
    assert found.gains is None


@pytest.mark.parametrize("masks", [None, [-7.0]])
def test_without_masks_every_pose_is_a_sighting(masks: list[float] | None) -> None:
    """Catches an exception where the robot recorded no masks, or none that belongs to a pose."""
    poses = {**believing_trial().scan.poses, TARGET: [believed(t, error_at(t)) for t in OWN]}
    found = beliefs(believing_trial(poses=poses, masks=masks))
    np.testing.assert_allclose(
        found.errors["tracking"], DRIFT * (LAST - FIRST - LAST), atol=SMOOTHED
    )


def test_a_mask_belongs_to_the_pose_of_its_time() -> None:
    """Catches a tolerance that takes a prediction for a sighting: a mask within 1 ms makes it
    one.
    """
    targets = [believed(t, error_at(t)) for t in [*OWN, -0.2]]
    poses = {**believing_trial().scan.poses, TARGET: targets}
    for late, last in ((0.0009, -0.2), (0.0011, LAST)):
        found = beliefs(believing_trial(poses=poses, masks=[*OWN, -0.2 + late]))
        wrong = (BELIEVED - OBJECT_VELOCITY - DRIFT) * -last
        np.testing.assert_allclose(found.errors["velocity"], wrong, atol=SMOOTHED)


# the robot's own model


def test_the_model_that_the_robot_had_then_is_used() -> None:
    """Catches the first or the last model of the log in place of the last one before the
    sighting.
    """
    off = own_model() + np.array([0.02, 0.02, 0.02])
    models = [(-2.0, off), (LAST - 0.01, own_model()), (LAST + 0.01, off)]
    found = beliefs(believing_trial(models=models))
    expected = START + DRIFT * (LAST - FIRST - LAST)
    np.testing.assert_allclose(found.errors["tracking"], expected, atol=0.001)
    # recorded after the sighting only, it is better than none
    found = beliefs(believing_trial(models=[(LAST + 0.01, own_model()), (LAST + 0.02, off)]))
    np.testing.assert_allclose(found.errors["tracking"], expected, atol=0.001)


def test_a_model_of_a_few_points_is_none() -> None:
    """Catches a surface laid on nineteen points; the first belief stands in for it."""
    found = beliefs(believing_trial(models=[(FIRST, own_model()[:19])]))
    np.testing.assert_allclose(
        found.errors["tracking"], DRIFT * (LAST - FIRST - LAST), atol=SMOOTHED
    )


# an object that was pushed

PUSH = shift(CENTRE) @ turn("z", 25.0) @ shift(np.array([0.02, 0.03, 0.0]) - CENTRE)


def pushed_hindsight(pushed: float, until: float = 0.0) -> Any:
    """The object is off its path by PUSH from a time on, and is seen so until another."""
    times = every(0.04, -1.6, until)
    seen = sighted(times, moved=lambda t: PUSH if t >= pushed - 1e-6 else np.eye(4))
    return hindsight_of(sighted(SIGHTED), sightings=seen, pushed=pushed)


def test_a_belief_that_follows_a_push_is_no_error() -> None:
    """Catches a pushed object compared with the path that it had left."""
    pushed = -1.36  # before the second over which the drift is taken

    def target(t: float) -> StampedPose:
        return believed(t, error_at(t), PUSH if t > pushed - 0.001 else None)

    own = every(0.04, -1.48, -0.32)
    poses = {**believing_trial().scan.poses, TARGET: [target(t) for t in own]}
    trial = believing_trial(poses=poses, masks=own, models=[(-1.48, own_model())])
    found = beliefs(trial, pushed_hindsight(pushed))
    np.testing.assert_allclose(found.errors["tracking"], error_at(0.0), atol=0.001)


def test_the_goal_is_the_grasp_on_the_undisturbed_object() -> None:
    """Catches a product in the wrong order, and a grasp that is not carried on with the object."""
    trial = believing_trial()
    grasp = trial.scan.poses[GRASP][1]
    T_grasp = shift(-SERVO - BELIEVED * 0.02) @ palm_at(0.0)
    assert grasp.t_ns < trial.event_ns("close")
    found = beliefs(trial).goal
    assert found is not None
    np.testing.assert_allclose(found, shift(OBJECT_VELOCITY * 0.02) @ T_grasp, atol=SMOOTHED)
    # commanded on a pushed object, it is put back with it to where the object would have been
    found = beliefs(trial, pushed_hindsight(-0.12, until=-0.04)).goal
    assert found is not None
    then, undisturbed = PUSH @ box_at(-0.04), box_at(0.0)  # where it was seen next to the grasp
    np.testing.assert_allclose(found, undisturbed @ invert(then) @ T_grasp, atol=SMOOTHED)


def test_the_goal_is_of_the_last_grasp_whose_object_was_seen() -> None:
    """Catches an object that was seen more than 50 ms away in time, or not at all, taken for
    seen.
    """
    early, late = grasp_for(-0.2), grasp_for(-0.1)
    poses = {**believing_trial().scan.poses, GRASP: [early, late]}
    trial = believing_trial(poses=poses)
    for until, apart in ((-0.16, True), (-0.12, False)):  # 60 and 20 ms before the later grasp
        found = beliefs(trial, pushed_hindsight(-0.24, until)).goal
        assert found is not None
        t = -0.2 if apart else -0.1
        near = -0.2 if apart else -0.12
        then = PUSH @ box_at(near)
        expected = box_at(0.0) @ invert(then) @ shift(-SERVO) @ palm_at(t)
        np.testing.assert_allclose(found, expected, atol=SMOOTHED)
    # pushed before the first grasp and never seen after it
    assert beliefs(trial, hindsight_of(sightings=sighted([-0.9]), pushed=-0.25)).goal is None


# a hand that never closed

NEAREST = -0.4  # s


def open_trial(*, changes: float = 9.0, first: float = -1.9, **changed: Any) -> Any:
    """A trial without a close; its palm is nearest to its grasp at NEAREST. changes: when the
    believed velocity goes wild.
    """
    grasps = [grasp_for(t, SERVO * (1 + abs(t - NEAREST))) for t in every(0.1, -1.5, 0.9)]
    own = every(0.1, FIRST, -0.6)
    velocities = [twist(t, BELIEVED if t <= changes else WILD) for t in every(0.1, first, 0.9)]
    given: dict[str, Any] = {
        "close": None,
        "poses": {GRASP: grasps, TARGET: [believed(t, error_at(t)) for t in own]},
        "twists": {VELOCITY: velocities},
        "masks": own,
        "config": Config.model_validate({"servo": {"c_p_v": 2.0}}),
    }
    return trial_of(**{**given, **changed})


@pytest.mark.parametrize(
    ("contact", "pushed", "changes"),
    [(None, None, NEAREST), (-0.5, None, -0.8), (None, -0.55, -0.85), (-0.5, -0.45, -0.8)],
)
def test_without_a_close_the_errors_are_those_when_it_was_nearest(
    contact: float | None, pushed: float | None, changes: float
) -> None:
    """Catches errors at the log's end, a belief about a pushed object, and a lag that is not over
    the servo's gain.
    """
    hindsight = hindsight_of(contact=contact, pushed=pushed)
    found = beliefs(open_trial(changes=changes), hindsight)
    np.testing.assert_allclose(found.errors["servo"], SERVO, atol=1e-8)
    expected = DRIFT * (-0.6 - FIRST) + DRIFT * (NEAREST + 0.6)
    np.testing.assert_allclose(found.errors["tracking"], expected, atol=SMOOTHED)
    wrong = (BELIEVED - OBJECT_VELOCITY - DRIFT) / 2.0
    np.testing.assert_allclose(found.errors["velocity"], wrong, atol=SMOOTHED)
    if pushed is None:
        # that grasp, on the object where it is at the log's end, 1 s
        assert found.goal is not None
        T = shift(OBJECT_VELOCITY * (1.0 - NEAREST) - SERVO) @ palm_at(NEAREST)
        np.testing.assert_allclose(found.goal, T, atol=SMOOTHED)


def test_a_velocity_that_has_not_settled_is_no_belief() -> None:
    """Catches the filter's start taken for what the robot believed: it must have run for a
    second.
    """
    at = NEAREST - 1.0
    assert "velocity" in beliefs(open_trial(first=at)).errors
    assert "velocity" not in beliefs(open_trial(first=at + 0.1)).errors


# the servo's gains


def test_gains_of_the_commands_up_to_the_first_contact() -> None:
    """Catches a command of another time, one after the contact, and the target's velocity left in
    it.
    """
    level, upright = 1.5, 2.5
    grasps, commands, velocities = [], [], []
    for k, t in enumerate(every(0.1, -1.5, -0.1)):
        apart = np.array([0.05 - 0.004 * k, 0.03 + 0.003 * k, -0.08 + 0.002 * k])
        grasps.append(grasp_for(t, -apart))
        velocity = BELIEVED * (1 + 0.1 * k)
        usual = velocity + apart * [level, level, upright]
        # before, the hand's pose is not known; after, it touches the object
        known = -1.21 < t < -0.79
        commands += [twist(t - 0.01, usual if known else WILD), twist(t + 0.01, WILD)]
        velocities += [twist(t - 0.005, velocity), twist(t + 0.005, WILD)]
    poses = {**believing_trial().scan.poses, GRASP: grasps}
    twists = {COMMAND: commands, VELOCITY: velocities}
    hands = hand_poses(every(0.02, -1.22, 1.0))
    poses[TARGET] = [believed(t, error_at(t)) for t in every(0.1, -1.2, LAST)]
    trial = believing_trial(poses=poses, twists=twists, hands=hands)
    found = beliefs(trial, hindsight_of(contact=-0.5)).gains
    assert found == pytest.approx((level, upright), rel=1e-6)
    # of a push it is told late as well
    pushed = hindsight_of(pushed=-0.5, sightings=sighted(every(0.04, -1.6, 0.0)))
    assert beliefs(trial, pushed).gains == pytest.approx((level, upright), rel=1e-6)
    found = beliefs(trial, hindsight_of()).gains
    assert found is not None
    assert abs(found[0] - level) > 0.1


@pytest.mark.parametrize(("apart", "known"), [(0.0101, True), (0.0099, False)])
@pytest.mark.parametrize("level", [True, False])
def test_gains_need_room_to_be_seen_in(apart: float, known: bool, level: bool) -> None:
    """Catches another limit than a root mean square of 10 mm, level and upright each."""
    small, far = np.array([0.6, 0.8, 0.0]) * apart, np.array([0.0, 0.0, 1.0]) * 0.05
    if not level:
        small, far = np.array([0.0, 0.0, -apart]), np.array([0.05, 0.0, 0.0])
    speeds = [(small + far) * [3.0, 3.0, 4.0]] * 5
    assert gains_of([small + far] * 5, speeds) == (pytest.approx((3.0, 4.0)) if known else None)


# nothing to say


NOT_RECORDED = "beliefs not recorded"
NOT_KNOWN = "where camera and object were when the robot last saw the object is not known"
TARGETS = [believed(t, START) for t in OWN]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"poses": {}}, NOT_RECORDED),
        ({"poses": {GRASP: [grasp_for(0.1)], TARGET: TARGETS}}, NOT_RECORDED),
        ({"poses": {GRASP: [grasp_for(-0.1)], TARGET: TARGETS[:1]}}, NOT_RECORDED),
        ({"poses": {GRASP: [grasp_for(-0.1)], TARGET: [*TARGETS[:1], believed(0.1, START)]}},
         NOT_RECORDED),
        ({"hands": hand_poses(every(0.02, -2.0, -0.1))}, NOT_RECORDED),
        ({"close": None, "poses": {TARGET: TARGETS}}, NOT_RECORDED),
        ({"close": None, "hands": hand_poses(every(0.02, 0.2, 1.0)),
          "poses": {GRASP: [grasp_for(-0.1)], TARGET: TARGETS}}, NOT_RECORDED),
        ({"hands": hand_poses(every(0.02, -1.4, 1.0))}, NOT_KNOWN),
        ({"hands": hand_poses([t for t in every(0.02, -2.0, 1.0) if not -0.7 < t < -0.1])},
         NOT_KNOWN),
    ],
)  # fmt: skip
def test_why_nothing_can_be_said(changed: dict[str, Any], why: str) -> None:
    """Catches an error that is told without the palm, the grasp, the camera or the robot's pose of
    the object.
    """
    assert beliefs_of(log_of(believing_trial(**changed)), hindsight_of()) == Unknown(why)


def test_where_a_pushed_object_was_not_seen_nothing_can_be_said() -> None:
    """Catches the path it had left, or a sighting more than 50 ms away, taken for where it was."""
    assert beliefs_of(log_of(believing_trial()), pushed_hindsight(-0.5, LAST - 0.06)) == Unknown(
        NOT_KNOWN
    )
    assert isinstance(
        beliefs_of(log_of(believing_trial()), pushed_hindsight(-0.5, LAST - 0.02)), Beliefs
    )


# parts


def test_beliefs_in_another_frame() -> None:
    """Catches errors that are moved as points are, and a goal that is turned on the wrong side."""
    T, goal = shift([0.3, -0.2, 0.1]) @ turn("z", 90.0), shift([1.0, 2.0, 3.0]) @ turn("x", 30.0)
    moved = Beliefs({"servo": np.array([1.0, 2.0, 3.0])}, goal, (1.0, 2.0)).moved(T)
    np.testing.assert_allclose(moved.errors["servo"], [-2.0, 1.0, 3.0], atol=1e-12)
    assert moved.goal is not None
    np.testing.assert_allclose(moved.goal[:3, 3], [0.3 - 2.0, -0.2 + 1.0, 0.1 + 3.0], atol=1e-12)
    np.testing.assert_allclose(
        moved.goal[:3, :3], (turn("z", 90.0) @ turn("x", 30.0))[:3, :3], atol=1e-12
    )
    assert moved.gains == (1.0, 2.0)
    assert Beliefs({}, None, None).moved(T).goal is None


def test_a_steady_velocity_is_the_median_of_half_a_second() -> None:
    """Catches a mean, a window whose ends are left out or that reaches farther, and an angular
    part.
    """
    values = {
        -1.0: 9.0,
        -0.51: 9.0,
        -0.5: 1.0,
        -0.3: 2.0,
        -0.2: 3.0,
        -0.1: 4.0,
        0.0: 99.0,
        0.01: 50.0,
    }
    twists = [twist(t, (v, -v, 0.0), (7, 7, 7)) for t, v in values.items()]
    until = twist(0.0, (0, 0, 0))[0]
    np.testing.assert_allclose(steady(twists, until), [[3.0, -3.0, 0.0]])
    assert steady(twists[1:], until) == []
    assert steady([], until) == []
    assert steady(twists[:1], until) == []  # the filter had gone on for long, and then stopped


def test_growth_is_the_slope_of_a_line_by_least_squares() -> None:
    """Catches a slope between the ends, and one through zero; five sightings are enough."""
    rng = np.random.default_rng(3)
    seconds = np.sort(rng.uniform(50.0, 51.0, 5))
    errors = rng.normal(0.0, 0.01, (5, 3)) + 1.0
    expected = np.polyfit(seconds - 50.0, errors, 1)[0]
    times = [round(t * 1e9) for t in seconds]
    np.testing.assert_allclose(growth(times, list(errors)), expected, atol=1e-7)
    np.testing.assert_array_equal(growth(times[:4], list(errors[:4])), np.zeros(3))


def test_a_drift_is_tracking_s_and_not_the_velocity_s() -> None:
    """Catches a drift counted twice, and a lag over the time since the last sighting where the hand
    never closed.
    """
    tracking, drift, wrong = (
        np.array([1.0, 2.0, 3.0]),
        np.array([0.5, 0.0, -1.0]),
        np.array([2.0, 1.0, 0.0]),
    )
    for gain, by in ((None, 0.4), (4.0, 0.25)):
        found = carried(tracking, drift, wrong, 0.4, gain)
        np.testing.assert_allclose(found["tracking"], [1.2, 2.0, 2.6])
        np.testing.assert_allclose(found["velocity"], np.array([1.5, 1.0, 1.0]) * by)


# laying a surface on the robot's model

SPACED = np.stack(np.meshgrid(*3 * [np.arange(5) * 0.02]), axis=-1).reshape(-1, 3)  # m


def test_points_that_are_not_in_the_model_do_not_draw() -> None:
    """Catches a fit to all nearest pairs: 15 % of the points lie far off."""
    T = shift([0.002, -0.003, 0.001]) @ turn("y", 1.0)
    target = transform(T, SPACED)
    strays = SPACED.copy()
    strays[::7] += 0.5
    np.testing.assert_allclose(laid_on(strays, target), T, atol=1e-6)


def test_a_flat_surface_is_not_mirrored() -> None:
    """Catches a reflection: of a relief of 1 mm it fits the negative best, and no motion does."""
    i, j = np.divmod(np.arange(36), 6)
    relief = 0.001 * (-1.0) ** (i + j)
    points = np.column_stack([0.02 * i, 0.02 * j, relief])
    found = laid_on(points, points * [1.0, 1.0, -1.0])
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)
    assert found[2, 2] > 0.9


def test_a_turned_cloud_is_reached_in_several_steps() -> None:
    """Catches a fit that stops early: the first nearest points are mostly wrong ones."""
    rng = np.random.default_rng(1)
    points = transform(box_at(0.0) @ T_OBJECT_MODEL @ T_MODEL_OWN, own_model(600))
    points += rng.normal(0.0, 0.001, points.shape)  # no face slides along itself
    T = (
        shift(CENTRE)
        @ turn("xyz", [3.0, -2.0, 5.0])
        @ shift(np.array([0.006, -0.004, 0.003]) - CENTRE)
    )
    found = laid_on(points, transform(T, points))
    np.testing.assert_allclose(transform(found, points), transform(T, points), atol=0.0005)


def test_a_large_cloud_is_thinned_evenly() -> None:
    """Catches a cloud of which only the beginning is used, here one face, which slides along
    itself.
    """
    box = transform(T_OBJECT_MODEL @ T_MODEL_OWN, own_model(6000))
    box = box[np.argsort(box[:, 0], kind="stable")]
    found = laid_on(box, box + np.array([0.0, 0.004, -0.003]))
    np.testing.assert_allclose(found[:3, 3], [0.0, 0.004, -0.003], atol=0.0005)


def test_a_flat_box_far_off_is_reached() -> None:
    """Catches a fit that is trimmed from the start: it stops where most of the top lies on the top
    of the other.
    """
    flat = own_model(2000)
    flat = transform(T_OBJECT_MODEL @ T_MODEL_OWN, flat) / HALF * [0.045, 0.04, 0.014]
    seen = flat[flat[:, 2] > -0.008]  # by a camera above it
    far = np.array([0.015, -0.04, 0.0])
    found = laid_on(seen, flat + far)
    np.testing.assert_allclose(
        transform(found, seen).mean(axis=0), seen.mean(axis=0) + far, atol=0.003
    )


def test_the_tests_own_model_lies_on_hindsights_points() -> None:
    """Catches a mistake in the synthetic robot's model, which would show as an error of
    tracking.
    """
    box = transform(T_OBJECT_MODEL @ T_MODEL_OWN, own_model())
    np.testing.assert_allclose(laid_on(box_grid(), box)[:3, 3], 0.0, atol=0.0005)
