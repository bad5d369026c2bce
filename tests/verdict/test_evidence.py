"""Catches: a scene for the verdict in a wrong frame, at a wrong time or of a wrong sign, and a
refusal that is not given.

`scene_of` on a trial made of numbers (synthetic_trial.py), against closed forms. Nothing is
simulated.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config
from dgeval.failure_rule import Unknown
from dgeval.geometry import Array, transform
from dgeval.hindsight.smoothing import By, Sighting
from dgeval.perception.plane import Plane
from dgeval.recording.messages import JointSample
from dgeval.robots.described_hand import DescribedHand
from dgeval.robots.dlr_hit_hand import ACTUATED, GRASP_CENTRE
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.verdict.beliefs import Beliefs, beliefs_of
from dgeval.verdict.evidence import Scene, _empty, _rises, scene_of
from dgeval.verdict.log import log_of
from dgeval.worlds.closing import Finish
from tests.verdict.synthetic_trial import (
    CENTRE,
    COMMAND,
    GRASP,
    HALF,
    HAND_AT_CLOSE,
    HAND_TURN,
    HAND_VELOCITY,
    OBJECT_VELOCITY,
    RECORDED,
    SIGHTED,
    TABLE,
    TARGET,
    VELOCITY,
    box_at,
    box_grid,
    every,
    hand_at,
    hand_poses,
    hindsight_of,
    joint_position,
    joint_samples,
    ns,
    shift,
    sighted,
    stamped,
    trial_of,
    turn,
    twist,
    urdf_of,
)

# The support frame at the close, by hand: z is up, y is the motion's direction (0.6, 0.8, 0), x = y
# × z, and its origin is below the box's centre on the table.
R_SUPPORT_BASE = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
T_SUPPORT_BASE = np.eye(4)
T_SUPPORT_BASE[:3, :3] = R_SUPPORT_BASE
T_SUPPORT_BASE[:3, 3] = -R_SUPPORT_BASE @ [CENTRE[0], CENTRE[1], TABLE]
ALONG, UP = (
    np.array([0.0, 1.0, 0.0]),
    np.array([0.0, 0.0, 1.0]),
)  # the motion and the normal, support frame
SMOOTHED = 2e-6  # m, m/s: ten times what the smoother's prior takes off a velocity
TURNED = 1e-5  # of a rotation matrix, whose y axis is that of the velocity of 0.1 m/s


def scene(trial: Any = None, hindsight: Any = None) -> Scene:
    log = log_of(trial_of() if trial is None else trial)
    found = scene_of(log, hindsight_of() if hindsight is None else hindsight)
    assert isinstance(found, Scene), found
    return found


def seconds(found: Scene) -> Array:
    return (found.hand.t_ns - ns(0.0)) * 1e-9


# the support frame


def test_points_lie_on_the_support_with_the_motion_along_y() -> None:
    """Catches a frame of wrong hand, transposed or inverted, and points that are not where they are
    at the close.
    """
    found = scene()
    expected = transform(T_SUPPORT_BASE, transform(box_at(0.0), box_grid()))
    np.testing.assert_allclose(found.points, expected, atol=SMOOTHED)
    assert found.points[:, 2].min() == pytest.approx(0.0, abs=SMOOTHED)
    np.testing.assert_allclose(found.points.mean(axis=0), [0.0, 0.0, HALF[2]], atol=SMOOTHED)
    np.testing.assert_allclose(found.velocity, [0.0, 0.1, 0.0], atol=SMOOTHED)
    assert not found.held


@pytest.mark.parametrize(("speed", "along"), [(0.004, (0.0, 1.0)), (0.006, (1.0, 0.0))])
def test_at_rest_y_is_the_base_frames(speed: float, along: tuple[float, float]) -> None:
    """Catches a frame turned by the noise of a standing object's velocity; 5 mm/s is the limit."""
    path = sighted(SIGHTED, velocity=np.array([speed, 0.0, 0.0]))
    found = scene(hindsight=hindsight_of(path))
    y = np.array([*along, 0.0])
    R = np.stack([np.cross(y, [0.0, 0.0, 1.0]), y, [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        found.hand.T_support_hand[-1][:3, :3], R @ HAND_AT_CLOSE[:3, :3], atol=TURNED
    )
    np.testing.assert_allclose(found.velocity, R @ [speed, 0.0, 0.0], atol=SMOOTHED)


def test_a_tilted_support_gives_the_height() -> None:
    """Catches the base frame's z taken for the support's normal, and a velocity out of the
    support.
    """
    tilt = turn("x", 20.0)
    n = tilt[:3, 2]
    plane = Plane(n, -float(n @ [0.5, -0.2, 0.05]), 1.0)
    # up by 20 mm/s, which no standing object does
    velocity = tilt[:3, :3] @ [0.1, 0.0, 0.0] + 0.02 * n
    found = scene(hindsight=hindsight_of(sighted(SIGHTED, velocity=velocity), support=plane))
    centre = found.points.mean(axis=0)
    np.testing.assert_allclose(centre, [0.0, 0.0, plane.height(CENTRE)], atol=SMOOTHED)
    # x of the base lies in the plane: it is y of the support, and the support's x = y × z
    R = np.stack([np.cross([1.0, 0.0, 0.0], n), [1.0, 0.0, 0.0], n])
    np.testing.assert_allclose(
        found.hand.T_support_hand[-1][:3, :3], R @ HAND_AT_CLOSE[:3, :3], atol=TURNED
    )


# the object's motion


def test_the_undisturbed_motion_by_tick() -> None:
    """Catches a displacement from the first tick, of the wrong sign, in base axes, or with the
    wrong period of the ticks.
    """
    found = scene()
    np.testing.assert_allclose(seconds(found), np.arange(-200, 1) * 0.01, atol=1e-9)
    expected = np.outer(seconds(found), [0.0, 0.1, 0.0])
    np.testing.assert_allclose(found.free, expected, atol=2 * SMOOTHED)
    assert found.close == 200
    assert found.reference == 200
    np.testing.assert_array_equal(found.free[-1], 0.0)


def test_a_standing_object_does_not_leave_its_support() -> None:
    """Catches a drift of registration upwards that lets the twin's object fall."""
    velocity = np.array([0.06, 0.08, 0.01])
    found = scene(hindsight=hindsight_of(sighted(SIGHTED, velocity=velocity)))
    assert not found.held
    assert found.velocity[2] == 0
    np.testing.assert_array_equal(found.free[:, 2], 0.0)


def test_no_more_of_the_approach_than_twelve_seconds() -> None:
    found = scene(
        trial_of(
            hands=hand_poses(every(0.25, -15.0, 1.0)),
            joints=joint_samples(every(0.25, -15.0, 1.0)),
            first=-15,
        )
    )
    assert seconds(found)[0] == pytest.approx(-12.0)
    assert found.close == 1200


@pytest.mark.parametrize("first", [-1.5, -1.503])
def test_ticks_before_the_first_hand_pose_are_left_out(first: float) -> None:
    """Catches a refusal because tf began later than the images, and a close tick that counts what
    was left out.
    """
    found = scene(trial_of(hands=hand_poses(every(0.003, first, 0.999))))
    assert seconds(found)[0] == pytest.approx(-1.5)
    assert found.close == 150
    assert len(found.free) == len(found.seen) == len(found.hand.velocity) == 151


# how well its place is known


def test_the_place_is_as_sure_as_at_the_close() -> None:
    """Catches the uncertainty of another time: it grows with the velocity's from the last sighting
    on.
    """
    hindsight = hindsight_of()
    path = hindsight.path
    expected = np.hypot(path.sd[-1], path.sd_velocity * 0.12)
    assert scene(hindsight=hindsight).sd_m == pytest.approx(expected, rel=1e-9)


def test_without_a_close_the_place_counts_when_the_hand_was_nearest() -> None:
    """Catches the log's end taken for the moment that counts, and a distance to the hand's mount,
    not to its grasp.
    """
    nearest, apart = 0.3, np.array([0.0, 0.0, 0.08])
    relative = np.array([0.2, -0.1, 0.0])  # of the grasp's centre past the object, m/s

    def passing(t: float) -> Array:
        T = HAND_AT_CLOSE.copy()
        middle = CENTRE + OBJECT_VELOCITY * t + relative * (t - nearest) + apart
        T[:3, 3] = middle - T[:3, :3] @ GRASP_CENTRE
        return T

    hindsight = hindsight_of()
    found = scene(trial_of(hands=hand_poses(RECORDED, passing), close=None), hindsight)
    path = hindsight.path
    assert found.close is None
    assert found.reference == len(found.hand.t_ns) - 1 == 300  # the last frame is at 1 s
    assert found.sd_m == pytest.approx(
        np.hypot(path.sd[-1], path.sd_velocity * (nearest + 0.12)), rel=1e-9
    )
    assert len(found.hand.closing) == 0
    np.testing.assert_allclose(
        found.free, np.outer(seconds(found) - 1.0, [0.0, 0.1, 0.0]), atol=3 * SMOOTHED
    )


def test_the_turn_is_as_sure_as_the_sightings_agree() -> None:
    """Catches radians: sightings turned to and fro by 2 degrees about their middle lie 2 degrees
    off it.
    """
    path = sighted(SIGHTED)
    path = [
        replace(s, T_base_model=shift(c) @ turn("z", 2.0 * (-1) ** k) @ shift(-c) @ s.T_base_model)
        for k, s in enumerate(path)
        for c in [CENTRE + OBJECT_VELOCITY * SIGHTED[k]]
    ]
    assert scene(hindsight=hindsight_of(path)).sd_deg == pytest.approx(2.0, abs=0.01)


# what is held


RISING = 0.03 * UP  # m/s


def held(
    height: float,
    velocity: Array,
    *,
    support: bool = True,
    pushed: float | None = None,
    by: By = "registration",
    n: int = 38,
) -> Scene | str:
    """Scene of an object whose lowest point is so high above the table at the close. n: its
    sightings, the last at -0.12 s.
    """
    path = sighted(SIGHTED[-n:], centre=CENTRE + UP * height, velocity=velocity, by=by)
    hindsight = hindsight_of(path, pushed=pushed, n_registered=10)
    return scene_of(log_of(trial_of()), hindsight if support else replace(hindsight, support=None))


@pytest.mark.parametrize(
    ("height", "velocity", "expected"),
    [
        (0.10, RISING, True),
        (0.10, -RISING, True),  # handed down
        (0.10, 0 * RISING, False),  # of a tall box only the top was seen
        (0.028, RISING, False),
        (0.032, RISING, True),
    ],
)
def test_held_is_what_is_high_and_went_up_or_down(
    height: float, velocity: Array, expected: bool
) -> None:
    """Catches a rise of one sign only, and a height over the base frame's origin instead of the
    support's.
    """
    found = held(height, velocity)
    assert isinstance(found, Scene)
    assert found.held == expected
    # a held object moves upright too
    np.testing.assert_allclose(found.velocity, velocity * expected, atol=SMOOTHED)
    np.testing.assert_allclose(
        found.free[:, 2], seconds(found) * velocity[2] * expected, atol=3 * SMOOTHED
    )


def test_what_stands_keeps_its_height_while_it_is_not_seen() -> None:
    """Fails where the error of a velocity, over the second since the last sighting, sinks it into
    its support: cut there, a box is lower than it is, and a ball is none.
    """
    path = sighted(every(0.05, -2.0, -1.0), velocity=np.array([0.1, 0.0, -0.008]))
    found = scene(hindsight=hindsight_of(path))
    # by its velocity its lowest point is on the table at the close; it was last seen 8 mm higher
    assert found.points[:, 2].min() == pytest.approx(0.008, abs=3 * SMOOTHED)
    np.testing.assert_allclose(found.points.mean(axis=0)[:2], 0.0, atol=3 * SMOOTHED)
    assert not found.held


@pytest.mark.parametrize(("rise", "expected"), [(0.0075, False), (0.0081, True)])
def test_a_wobble_of_registration_is_no_rise(rise: float, expected: bool) -> None:
    """Catches another limit than 7 mm between the 5th and 95th percentile, which is 0.9 of a steady
    rise.
    """
    found = held(0.1, RISING / 0.03 * rise / (SIGHTED[-1] - SIGHTED[0]))
    assert isinstance(found, Scene)
    assert found.held == expected


def test_only_registrations_before_a_push_and_the_close_tell_a_rise() -> None:
    """Catches a lift by the hand itself that is taken for a person's, and a rise told by colour or
    by four frames.
    """
    for found in (
        held(0.1, RISING, by="colour"),
        held(0.1, 3 * RISING, n=4),
        held(0.1, RISING, pushed=-1.5),
    ):
        assert isinstance(found, Scene)
        assert not found.held
    pushed_late = held(0.1, RISING, pushed=-0.1)
    assert isinstance(pushed_late, Scene)
    assert pushed_late.held
    # it stands high until the close, and goes up with the hand after it
    still = sighted(SIGHTED, centre=CENTRE + UP * 0.1, velocity=0 * RISING)
    lifted = sighted(every(0.04, 0.2, 1.0), centre=CENTRE + UP * 0.1, velocity=5 * RISING)
    assert not scene(hindsight=hindsight_of(still, sightings=[*still, *lifted])).held


def test_without_a_support_a_held_object_gets_one_below_it() -> None:
    """Catches a surface through the held object; it is put 0.25 m below the lowest point."""
    found = held(0.1, RISING, support=False)
    assert isinstance(found, Scene)
    assert found.held
    assert found.points[:, 2].min() == pytest.approx(0.25, abs=SMOOTHED)


# the hand


def test_the_hand_in_the_support_frame() -> None:
    """Catches products in the wrong order, and the palm's frame in place of the hand's."""
    found = scene()
    expected = np.array([T_SUPPORT_BASE @ hand_at(t) for t in seconds(found)])
    np.testing.assert_allclose(found.hand.T_support_hand, expected, atol=TURNED)
    np.testing.assert_allclose(
        found.hand.T_support_hand[:, :3, 3], expected[:, :3, 3], atol=2 * SMOOTHED
    )


def test_fingers_and_closing_follow_the_joint_samples() -> None:
    """Catches drives in another order, coupled joints among them, and a closing that begins at the
    close or before it.
    """
    found = scene()
    preshape = [joint_position(name, -1.0) for name in ACTUATED]
    assert found.gripper is FIVE_FINGERS
    np.testing.assert_allclose(found.hand.fingers, np.tile(preshape, (201, 1)), atol=1e-9)
    assert found.hand.closing.shape == (
        50,
        15,
    )  # 0.4 s of closing and 0.1 s of rest, by ticks of 10 ms
    expected = [[joint_position(name, 0.01 * k) for name in ACTUATED] for k in range(1, 51)]
    np.testing.assert_allclose(found.hand.closing, expected, atol=1e-9)


def test_closing_ends_with_the_joint_samples() -> None:
    found = scene(trial_of(joints=joint_samples(every(0.02, -2.0, 0.22))))
    assert found.hand.closing.shape == (22, 15)
    found = scene(trial_of(joints=joint_samples(every(0.02, -2.0, 0.0))))
    assert found.hand.closing.shape == (0, 15)


def test_the_clock_of_the_joints_is_put_right() -> None:
    """Catches an offset that is subtracted, or that is used in the tf tree only."""
    config = Config.model_validate({"clock": {"hand_joints": {"offset_ns": 100_000_000}}})
    found = scene(trial_of(config=config))
    expected = [[joint_position(name, 0.01 * k - 0.1) for name in ACTUATED] for k in range(1, 51)]
    np.testing.assert_allclose(found.hand.closing, expected, atol=1e-9)


def test_the_hand_follows_the_believed_velocity_once_there_is_one() -> None:
    """Catches a belief of the future, and one in base axes; before the first belief the object's
    own velocity stands in.
    """
    twists = {
        VELOCITY: [
            twist(-1.0, (0.06, 0.08, 0.0)),
            twist(-0.5, (0.08, -0.06, 0.02), (1, 2, 3)),
            twist(0.01, (9, 9, 9)),
        ]
    }
    found = scene(trial_of(twists=twists))
    t = seconds(found)
    expected = np.where(
        (t < -1.005)[:, None],
        found.velocity,
        np.where((t < -0.505)[:, None], [0.0, 0.1, 0.0], [0.1, 0.0, 0.02]),
    )
    np.testing.assert_allclose(found.hand.velocity, expected, atol=2 * SMOOTHED)
    np.testing.assert_allclose(found.hand.velocity[-1], [0.1, 0.0, 0.02], atol=2 * SMOOTHED)


def test_without_commands_the_hand_would_have_gone_on_as_measured() -> None:
    """Catches a twist of the wrong sign, over the wrong time, or about axes of the hand instead of
    the support's.
    """
    found = scene()
    expected = np.concatenate([R_SUPPORT_BASE @ HAND_VELOCITY, R_SUPPORT_BASE @ HAND_TURN])
    np.testing.assert_allclose(found.hand.going, expected, atol=TURNED)


def test_measured_motion_is_that_of_the_last_ticks() -> None:
    """Catches a mean over the whole approach: the hand stands still until 60 ms before the
    close.
    """
    jump = np.array([0.0, 0.0, -0.2])

    def late(t: float) -> Array:
        T = HAND_AT_CLOSE.copy()
        T[:3, 3] += jump * max(t, -0.06)
        return T

    np.testing.assert_allclose(
        scene(trial_of(hands=hand_poses(RECORDED, late))).hand.going[:3], jump, atol=1e-9
    )
    # of 50 ms, that is: from 40 ms before the close on it has gone four fifths of it
    found = scene(trial_of(hands=hand_poses(RECORDED, lambda t: late(t if t > -0.04 else -0.04))))
    np.testing.assert_allclose(found.hand.going[:3], 0.8 * jump, atol=1e-9)


def test_the_last_command_tells_how_the_hand_would_have_gone_on() -> None:
    """Catches a command of the palm taken for the hand's, one in base axes, one after the close,
    and one too old.
    """
    linear, angular = np.array([0.02, -0.05, -0.03]), np.array([0.3, -0.2, 0.5])
    commands = [twist(-0.04, (1, 1, 1)), twist(-0.02, linear, angular), twist(0.001, (2, 2, 2))]
    found = scene(trial_of(twists={COMMAND: commands}))
    # the hand's origin turns about the palm's: v + w × (hand - palm)
    palm = HAND_AT_CLOSE @ FIVE_FINGERS.T_hand_palm
    v = linear + np.cross(angular, HAND_AT_CLOSE[:3, 3] - palm[:3, 3])
    expected = np.concatenate([R_SUPPORT_BASE @ v, R_SUPPORT_BASE @ angular])
    np.testing.assert_allclose(found.hand.going, expected, atol=TURNED)

    measured = scene().hand.going
    for age, used in ((0.050, True), (0.051, False)):
        found = scene(trial_of(twists={COMMAND: [twist(-age, linear, angular)]}))
        np.testing.assert_allclose(found.hand.going, expected if used else measured, atol=TURNED)


# what was seen


def test_seen_is_the_motion_from_the_reference() -> None:
    """Catches a pose in place of a motion, one from another time, and the inverse of it."""
    found = scene()
    for k, t in enumerate(seconds(found)):
        if any(abs(t - s) < 0.001 for s in SIGHTED):
            np.testing.assert_allclose(found.seen[k], shift([0.0, 0.1 * t, 0.0]), atol=TURNED)
            np.testing.assert_allclose(
                transform(found.seen[k], found.points), found.points + 0.1 * t * ALONG, atol=TURNED
            )
        else:
            assert np.isnan(found.seen[k]).all()
    assert np.isfinite(found.seen[:, 0, 0]).sum() == len(SIGHTED)


def test_a_sighting_counts_at_the_nearest_tick() -> None:
    """Catches a sighting at the tick before or after it, and sightings after the close."""
    times = [-0.296, -0.204, -0.104, 0.3]
    found = scene(hindsight=hindsight_of(sightings=sighted(times), n_registered=30))
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(found.seen[:, 0, 0])), [170, 180, 190])


def test_a_push_is_seen_and_a_single_wrong_sighting_is_not() -> None:
    """Catches a smoothing that takes a push away, and one that lets an outlier in the middle
    through.
    """
    push, times = turn("z", 10.0), every(0.04, -1.0, 0.0)
    push = shift(CENTRE + UP * 0.03) @ push @ shift(-CENTRE)

    def moved(t: float) -> Array:
        return push if t > -0.21 else shift([0.05, 0.0, 0.0]) if abs(t + 0.6) < 0.001 else np.eye(4)

    found = scene(hindsight=hindsight_of(sightings=sighted(times, moved=moved)))
    known = np.isfinite(found.seen[:, 0, 0])
    assert known.sum() == len(times) - 1
    assert not known[140]  # 0.6 s before the close
    expected = transform(T_SUPPORT_BASE @ push @ box_at(0.0), box_grid())
    np.testing.assert_allclose(transform(found.seen[-1], found.points), expected, atol=TURNED)
    np.testing.assert_allclose(found.seen[120], shift([0, -0.08, 0]), atol=TURNED)


def test_nothing_seen_of_the_approach() -> None:
    """Catches an exception where all sightings came before the ticks or after the close."""
    trial = trial_of(hands=hand_poses(every(0.02, -0.5, 1.0)))
    found = scene(trial, hindsight_of(sightings=sighted([-1.6, -1.2, 0.5]), n_registered=9))
    assert np.isnan(found.seen).all()


# the beliefs


def test_beliefs_come_in_the_support_frame() -> None:
    """Catches errors that are moved as points, and a goal that is only turned."""
    poses = {
        GRASP: [stamped(-0.1, HAND_AT_CLOSE)],
        TARGET: [stamped(t, np.eye(4)) for t in (-1.0, -0.5, -0.1)],
    }
    trial, hindsight = (
        trial_of(poses=poses, twists={VELOCITY: [twist(-0.2, (0.1, 0.0, 0.0))]}),
        hindsight_of(),
    )
    base, found = beliefs_of(log_of(trial), hindsight), scene(trial, hindsight).beliefs
    assert isinstance(base, Beliefs)
    assert isinstance(found, Beliefs)
    assert base.goal is not None
    assert found.goal is not None
    assert set(found.errors) == {"servo", "tracking", "velocity"}
    for part, error in found.errors.items():
        np.testing.assert_allclose(error, R_SUPPORT_BASE @ base.errors[part], atol=TURNED)
    np.testing.assert_allclose(found.goal, T_SUPPORT_BASE @ base.goal, atol=TURNED)
    assert scene().beliefs == Unknown("beliefs not recorded")


# no scene


OTHER_HAND = (
    '<robot name="r"><link name="base_link"/><link name="hand_base"/><link name="palm_link"/>'
    + (
        '<link name="camera_color_optical_frame"/>'
        '<joint name="a" type="fixed"><parent link="hand_base"/><child link="palm_link"/></joint>'
        '<joint name="b" type="fixed"><parent link="hand_base"/>'
        '<child link="camera_color_optical_frame"/></joint></robot>'
    )
)
NO_GEOMETRY = "no robot description: the hand's geometry is not known"
UNKNOWN_HAND = "the description has no hand that moves on 'palm_link'"
TOO_SHORT = "less than 0.2 s of the approach has a known hand pose"


def without(samples: list[JointSample], first: float, last: float) -> list[JointSample]:
    return [s for s in samples if not ns(first) < s.t_ns < ns(last)]


@pytest.mark.parametrize(
    ("trial", "hindsight", "why"),
    [
        ({"description": None}, {}, NO_GEOMETRY),
        ({"description": OTHER_HAND}, {}, UNKNOWN_HAND),
        ({}, {"n_registered": 4}, "the object was registered in only 4 frames before the close"),
        ({}, {"support": None}, "what the object stands on was never seen"),
        ({"hands": hand_poses(t for t in RECORDED if not -0.9 < t < -0.3)}, {},
         "the hand's pose is not known 0.89 s before the end of the approach"),
        ({"joints": without(joint_samples(RECORDED), -0.9, -0.3)}, {},
         "the hand's pose is not known 0.89 s before the end of the approach"),
        ({"hands": hand_poses(every(0.01, -2.0, -0.5))}, {},
         "the hand's pose is not known 0.49 s before the end of the approach"),
        ({"hands": hand_poses(every(0.01, -0.18, 1.0))}, {}, TOO_SHORT),
        ({"hands": hand_poses(every(0.01, 0.5, 1.0))}, {}, TOO_SHORT),
        ({"joints": []}, {}, TOO_SHORT),
    ],
)  # fmt: skip
def test_why_there_is_no_scene(trial: dict[str, Any], hindsight: dict[str, Any], why: str) -> None:
    """Catches a verdict from what is not known, and a reason that is not the one."""
    assert scene_of(log_of(trial_of(**trial)), hindsight_of(**hindsight)) == Unknown(why)


def test_a_hand_that_no_limit_closes_is_unknown() -> None:
    """Fails where a hand whose closed posture nothing tells closes on nothing in the twin, and
    every log without a close is an imprecise pose.
    """
    log = log_of(trial_of(close=None))
    hand = log.robot.hand_by_description
    assert isinstance(hand, DescribedHand)
    shut = replace(hand, geometry=replace(hand.geometry))
    shut.geometry.__dict__["closed"] = shut.geometry.open.copy()
    for known, is_told in ((hand, False), (shut, True)):
        log.robot.__dict__["hand_found"] = known
        why = scene_of(log, hindsight_of())
        assert (isinstance(why, Unknown) and "hand.closed" in why.reason) == is_told


def test_an_object_below_its_support_is_no_scene() -> None:
    """Fails where another surface taken for the support ends in a shape without height."""
    raised = Plane(np.array([0.0, 0.0, 1.0]), -TABLE - 0.2, 1.0)
    why = scene_of(log_of(trial_of()), hindsight_of(support=raised))
    assert isinstance(why, Unknown)
    assert "below what was taken for its support" in why.reason


def test_just_enough_for_a_scene() -> None:
    """Catches a limit that is off by one: five registered frames, twenty ticks, gaps of half a
    second.
    """
    assert scene(hindsight=hindsight_of(n_registered=5)).close == 200
    assert scene(trial_of(hands=hand_poses(every(0.01, -0.19, 1.0)))).close == 19
    assert (
        scene(trial_of(hands=hand_poses(t for t in RECORDED if not -0.9 < t < -0.4))).close == 200
    )


def test_without_a_base_frame_there_is_no_scene() -> None:
    trial = trial_of()
    trial = replace(trial, robot=replace(trial.robot, base_frame=None))
    assert scene_of(log_of(trial), hindsight_of()) == Unknown(
        "no pose of the camera in a base frame: the hand's way is not known"
    )


def test_the_jaw_is_known_too() -> None:
    """Catches a scene of five fingers for a gripper with two."""
    joints = [
        JointSample(ns(t), {"left_jaw": 0.05 - 0.01 * t, "right_jaw": 0.02}) for t in RECORDED
    ]
    found = scene(trial_of(description=urdf_of("jaw"), joints=joints))
    assert found.gripper.name == "parallel_jaw"
    np.testing.assert_allclose(found.hand.fingers[100], [0.06, 0.02], atol=1e-9)
    assert found.hand.closing.shape == (50, 2)
    np.testing.assert_allclose(
        found.hand.T_support_hand[-1], T_SUPPORT_BASE @ HAND_AT_CLOSE, atol=TURNED
    )


# where a hand rests that lifted nothing


@pytest.mark.parametrize(
    ("last", "released", "known"),
    [(3.0, None, True), (1.2, None, False), (3.0, 2.8, True), (3.0, 1.15, False)],
)
def test_a_hand_rests_empty_after_its_lift(
    monkeypatch: pytest.MonkeyPatch, last: float, released: float | None, known: bool
) -> None:
    """Fails where a hand that has not lifted yet, or that has opened again, rests empty; or one
    whose fingers press, though an operator calls the trial a failure.
    """
    grip = "dgeval.verdict.evidence.described_grip"
    monkeypatch.setattr(grip, lambda *_: None)
    log = log_of(trial_of(last=last, joints=joint_samples(every(0.02, -2.0, 3.0))))
    log = replace(log, released_ns=None if released is None else ns(released))
    drives = [j for j in log.robot.description.joints.values() if j.name in FIVE_FINGERS.drives]
    finish = Finish(np.zeros((115, 6)))  # it has lifted at 1.15 s
    hand: Any = None
    found = _empty(log, hand, drives, finish)
    assert (found is not None) == known
    if found is not None:
        end_ns = log.last_ns if released is None else ns(released)
        middle = end_ns - 55_000_000
        wanted = [log.robot.joints.position(j, middle, log.max_gap_ns) for j in drives]
        np.testing.assert_allclose(found, np.array(wanted, dtype=float), atol=1e-3)
    assert _empty(log, hand, drives, None) is None
    monkeypatch.setattr(grip, lambda *_: (True, "2 fingers press"))
    assert _empty(log, hand, drives, finish) is None


@pytest.mark.parametrize(
    ("contact_s", "pushed_s", "held"),
    [(1.5, 3.0, False), (None, 1.5, False), (None, None, True), (2.9, 3.0, True)],
)
def test_what_the_hand_topples_is_held_by_nobody(
    contact_s: float | None, pushed_s: float | None, held: bool
) -> None:
    """Fails where a box that the hand tips over, or one that sinks on it, is in someone's hand."""
    sightings = []
    for k in range(60):
        T = np.eye(4)
        T[2, 3] = 0.17 if k < 40 else 0.09  # it falls at 2 s
        sightings.append(Sighting(k * 50_000_000, T, "registration"))
    ns = [None if t is None else round(t * 1e9) for t in (contact_s, pushed_s)]
    hindsight: Any = SimpleNamespace(
        path=SimpleNamespace(centroid=np.zeros(3)),
        sightings=tuple(sightings),
        contact_ns=ns[0],
        pushed_ns=ns[1],
    )
    assert _rises(hindsight, np.eye(4), 4_000_000_000) == held
