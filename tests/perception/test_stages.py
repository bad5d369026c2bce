"""Catches, by stage: a sign, unit, frame or bound that differs from the papers.

The values are those of docs/papers.md, "Table V: parameters".
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dgeval.config import (
    EstimationConfig,
    ExecutionConfig,
    FusionConfig,
    ObservationConfig,
    PlaneConfig,
    RegistrationConfig,
    SelectionConfig,
    ServoConfig,
    TrackingConfig,
)
from dgeval.determinism import generator
from dgeval.errors import MissingDependencyError
from dgeval.geometry import (
    Intrinsics,
    depth_sigma,
    increment,
    invert,
    matrix_from_pose,
    rotation_angle,
    transform,
)
from dgeval.perception import align
from dgeval.perception.depth_noise import DepthNoise
from dgeval.perception.estimation import VelocityFilter
from dgeval.perception.fusion import Fusion, supported
from dgeval.perception.observation import observe
from dgeval.perception.plane import fit_plane
from dgeval.perception.registration import BACKENDS, gate, register
from dgeval.perception.self_filter import hand_pixels, signed_distance
from dgeval.perception.types import Features, Model, Observation, Registration, Tracked
from dgeval.planning.execution import execute
from dgeval.planning.grasps import overlap_allowed
from dgeval.planning.schedule import Delayed
from dgeval.planning.selection import by_metric, grasp_metric
from dgeval.planning.servo import Servo, blend_rotation, look_at_rotation
from dgeval.recording.frame import Frame
from dgeval.robots.description import LinkShape
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.robots.dlr_hit_hand import T_hand_palm
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_gicp import KdTree

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)


def at(
    x: float = 0, y: float = 0, z: float = 0, rotvec: tuple[float, float, float] = (0, 0, 0)
) -> np.ndarray:
    """Pose (4, 4) with a position m and a rotation vector rad."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    T[:3, 3] = (x, y, z)
    return T


# self-filter


@given(st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3))
def test_signed_distances_against_sampling(p: list[float]) -> None:
    """Catches a wrong distance or sign of sphere, capsule, box or cylinder: closed forms."""
    q = np.array([p])
    assert signed_distance(LinkShape("l", "sphere", np.eye(4), (0.1,)), q)[0] == pytest.approx(
        np.linalg.norm(q) - 0.1
    )
    axial = max(abs(p[2]) - 0.1, 0.0)
    expected = np.hypot(np.hypot(p[0], p[1]), axial) - 0.05
    assert signed_distance(LinkShape("l", "capsule", np.eye(4), (0.05, 0.1)), q)[
        0
    ] == pytest.approx(expected)
    half = np.array([0.1, 0.05, 0.08])
    clipped = np.clip(q, -half, half)
    distance = signed_distance(LinkShape("l", "box", np.eye(4), tuple(half)), q)[0]
    outside = float(np.linalg.norm(q - clipped))
    assert distance == pytest.approx(outside if outside > 0 else -float((half - np.abs(q)).min()))
    radial, height = np.hypot(p[0], p[1]) - 0.06, abs(p[2]) - 0.09
    expected = np.hypot(max(radial, 0), max(height, 0)) + min(max(radial, height), 0)
    assert signed_distance(LinkShape("l", "cylinder", np.eye(4), (0.06, 0.09)), q)[
        0
    ] == pytest.approx(expected)


def test_hull_is_its_planes() -> None:
    """Catches a wrong sign inside a hull, and a distance to the wrong plane."""
    from scipy.spatial import ConvexHull

    corners = np.array(np.meshgrid([-0.1, 0.1], [-0.05, 0.05], [-0.02, 0.02])).T.reshape(-1, 3)
    hull = LinkShape("l", "hull", np.eye(4), hull=ConvexHull(corners).equations)
    assert np.allclose(signed_distance(hull, np.array([[0, 0, 0], [0.13, 0, 0]])), [-0.02, 0.03])


def test_hand_pixels_take_the_hand_and_leave_what_is_behind() -> None:
    """Catches background taken for the hand, and a window's origin forgotten."""
    depth = np.full((240, 320), 0.6, np.float32)
    depth[100:140, 150:170] = 0.3
    shape = LinkShape("finger", "sphere", np.eye(4), (0.02,), bound=0.02)
    mask = hand_pixels(depth, (0, 0), CAMERA, [(shape, at(z=0.32))], 0.01)
    assert mask[120, 160]
    assert not mask[120, 100]
    assert not mask[110, 300]
    window = hand_pixels(depth[90:150, 140:180], (140, 90), CAMERA, [(shape, at(z=0.32))], 0.01)
    assert np.array_equal(window, mask[90:150, 140:180])


# plane


def test_plane_is_found_among_clutter_and_faces_the_camera() -> None:
    """Catches a plane tilted by clutter, and a normal away from the camera."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(-0.3, 0.3, (900, 2))
    table = np.column_stack([xy, 0.8 + 0.3 * xy[:, 0] + rng.normal(0, 0.001, 900)])
    clutter = rng.uniform([-0.3, -0.3, 0.5], [0.3, 0.3, 0.7], (400, 3))
    plane = fit_plane(np.vstack([table, clutter]), generator(0, "plane", 0), PlaneConfig())
    assert plane is not None
    expected = np.array([0.3, 0, -1]) / np.linalg.norm([0.3, 0, -1])
    assert np.degrees(np.arccos(abs(plane.n @ expected))) < 0.3
    assert plane.d > 0
    assert plane.height(np.array([[0, 0, 0.7]]))[0] > 0.05


def test_no_plane_in_a_ball() -> None:
    """Catches a plane where too few points lie in one."""
    points = np.random.default_rng(1).normal(0, 0.2, (600, 3)) + np.array([0, 0, 1])
    assert fit_plane(points, generator(0, "plane", 0), PlaneConfig(min_support=0.5)) is None


# observation


def test_observation_keeps_what_is_near_the_median_depth() -> None:
    """Catches another bound than the paper's |z - median z| <= 0.1 m (III-A.2), and wrong limits on
    the number of points.
    """
    depth = np.full((240, 320), 0.5, np.float32)
    depth[100:110, 100:120] = 0.59
    depth[110:120, 100:120] = 0.61
    frame = Frame(0, 0, np.zeros((240, 320, 3), np.uint8), depth, CAMERA, None, None)
    mask = np.ones((40, 40), dtype=bool)
    tracked = Tracked("tracked", window=(90, 90, 130, 130), mask=mask, mask_area=1600)
    observation = observe(
        frame, tracked, generator(0, "observation", 0), ObservationConfig(max_points=5000)
    )
    assert observation is not None
    assert sorted({round(float(z), 2) for z in observation.points[:, 2]}) == [0.5, 0.59]
    assert len(observation.points) == 1400
    few = observe(frame, tracked, generator(0, "observation", 0), ObservationConfig(max_points=300))
    assert few is not None
    assert len(few.points) == 300
    assert np.median(few.normals[np.linalg.norm(few.normals, axis=1) > 0.5][:, 2]) < -0.99
    assert (
        observe(frame, tracked, generator(0, "observation", 0), ObservationConfig(min_points=1500))
        is None
    )


# alignment and registration


def box_cloud(
    rng: np.random.Generator, n: int, noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) m and normals (n, 3) of three faces of a box 0.6 m in front of the camera.

    noise: standard deviation m.
    """
    half = np.array([0.08, 0.05, 0.035])
    normals, points = [], []
    for axis, sign in ((0, -1), (1, -1), (2, -1)):
        p = rng.uniform(-half, half, (n // 3, 3))
        p[:, axis] = sign * half[axis]
        points.append(p)
        normals.append(np.tile(np.eye(3)[axis] * sign, (n // 3, 1)))
    p = np.vstack(points) + rng.normal(0, noise, (3 * (n // 3), 3)) if noise else np.vstack(points)
    return p + np.array([0, 0, 0.6]), np.vstack(normals)


@pytest.mark.parametrize("name", sorted(BACKENDS))
def test_backends_recover_a_known_motion(name: str) -> None:
    """Catches a backend that returns the inverse: a cloud moved by 5 mm and 2 degrees.

    The inverse would be off by twice that.
    """
    rng = np.random.default_rng(3)
    target, normals = box_cloud(rng, 3000, 0.0005)
    source, _ = box_cloud(rng, 1200, 0.0005)
    centre = at(z=0.6)
    T_camera_model = centre @ at(0.003, -0.003, 0.0025, (0.02, -0.02, 0.02)) @ invert(centre)
    try:
        T = BACKENDS[name](
            transform(T_camera_model, source),
            Model(target, normals),
            np.eye(4),
            RegistrationConfig(),
        )
    except MissingDependencyError as error:
        pytest.skip(str(error))
    off = invert(T) @ invert(T_camera_model)
    assert np.linalg.norm(transform(off, np.array([[0, 0, 0.6]])) - [0, 0, 0.6]) < 0.0012
    assert np.degrees(np.linalg.norm(Rotation.from_matrix(off[:3, :3]).as_rotvec())) < 0.7


def test_alignment_steps_reach_the_true_pose() -> None:
    """Catches a wrong sign or Jacobian in the depth or the feature equations."""
    rng = np.random.default_rng(4)
    points, normals = box_cloud(rng, 900)
    truth = increment(np.array([0.004, -0.006, 0.005, 0.02, 0.01, -0.03]))
    pixels = CAMERA.project(transform(truth, points[::10]))
    T = np.eye(4)
    for _ in range(12):
        H, g, _ = align.feature_normal_equations(transform(T, points[::10]), pixels, CAMERA, 40.0)
        T = align.solve(H, g) @ T
    assert np.allclose(T, truth, atol=1e-5)
    T = np.eye(4)
    for _ in range(12):
        H, g, used = align.depth_normal_equations(
            transform(T, points),
            transform(truth, points),
            normals @ T[:3, :3].T,
            np.full(len(points), 0.001),
            0.05,
        )
        T = align.solve(H, g) @ T
    assert used == len(points)
    assert np.allclose(T, truth, atol=1e-4)


def registration_at(T: np.ndarray, fitness: float = 0.9) -> Registration:
    """A registration with that T_camera_model and gate fitness."""
    return Registration(T, 1.0, fitness, 0.001, None)


def test_gate_bounds_are_the_papers() -> None:
    """Catches other bounds than 4 m/s and 4 rad/s, and a time step that ignores dropped frames.

    At 30 Hz 13.2 cm and 7.5 degrees pass, 13.5 cm and 7.8 degrees do not.
    """
    c, dt, centre = RegistrationConfig(), 1 / 30, np.array([0.0, 0, 0.5])
    about = at(z=0.5)

    def turned(degrees: float) -> np.ndarray:
        return about @ at(rotvec=(0, np.radians(degrees), 0)) @ invert(about)

    assert gate(registration_at(at(x=0.132)), np.eye(4), centre, dt, c) is None
    assert gate(registration_at(at(x=0.135)), np.eye(4), centre, dt, c) == "translation"
    assert gate(registration_at(turned(7.5)), np.eye(4), centre, dt, c) is None
    assert gate(registration_at(turned(7.8)), np.eye(4), centre, dt, c) == "rotation"
    assert gate(registration_at(at(x=0.26)), np.eye(4), centre, 2 * dt, c) is None
    assert gate(registration_at(np.eye(4), 0.8), np.eye(4), centre, dt, c) == "fitness"


def test_gate_fitness_sees_the_shift_that_plain_fitness_does_not() -> None:
    """Catches a gate that counts within the search radius: on a box a shift of 10 mm has a share of
    1.00 within 20 mm (docs/papers.md, "ICP direction and fitness"), but under 0.5 within the gate's
    5 mm.
    """
    rng = np.random.default_rng(5)
    points, normals = box_cloud(rng, 3000)
    moved = Observation(points[::3] + 0.01, normals[::3])
    c = RegistrationConfig(max_iterations=1, search_radius=0.02)
    tree = KdTree(points)
    distance = np.sqrt(tree.batch_nearest_neighbor_search(moved.points)[1])
    assert (distance < 0.02).mean() > 0.99
    assert (distance < 0.005).mean() < 0.5
    result = register(
        Observation(points[::3], normals[::3]), Model(points, normals), np.eye(4), None, CAMERA, c
    )
    assert result.gate_fitness > 0.99


def parcel(rng: np.random.Generator, n: int, sigma: float) -> Observation:
    """A face of 0.3 x 0.2 m, 1 m before the camera, with noise along the view."""
    points = np.column_stack(
        [rng.uniform(-0.15, 0.15, n), rng.uniform(-0.1, 0.1, n), 1.0 + rng.normal(0, sigma, n)]
    )
    return Observation(points, np.tile([0.0, 0.0, -1.0], (n, 1)))


def test_a_large_model_takes_a_second_look() -> None:
    """Fails where distances are taken between points: those of a large model are 6 mm apart."""
    rng = np.random.default_rng(2)
    first, second = parcel(rng, 1500, 0.001), parcel(rng, 1000, 0.001)
    model = Model(first.points, first.normals)
    result = register(second, model, np.eye(4), None, CAMERA, RegistrationConfig())
    distance = np.sqrt(KdTree(first.points).batch_nearest_neighbor_search(second.points)[1])
    assert (distance < 0.005).mean() < 0.8
    assert result.gate_fitness > 0.98


def test_a_face_that_comes_into_view_at_once_does_not_turn_the_model() -> None:
    """Fails where ICP lays a face that the model lacks onto the one it has, though the features
    stay where they were.
    """
    rng = np.random.default_rng(5)
    points, normals = box_cloud(rng, 3000, 0.001)
    centre = at(z=0.6)
    turned = centre @ at(0, 0, 0, (0, 0.6, 0)) @ invert(centre)
    points, normals = transform(turned, points), normals @ turned[:3, :3].T
    front, side = np.split(np.arange(3000), 3)[2], np.split(np.arange(3000), 3)[0]
    both = np.concatenate([front[:150], side])
    seen = Observation(points[both], normals[both])
    model = Model(points[front], normals[front])
    marks = points[front][:40]
    off = []
    for features in (None, Features(marks, CAMERA.project(marks))):
        T = register(seen, model, np.eye(4), features, CAMERA, RegistrationConfig()).T_camera_model
        off.append(float(np.degrees(rotation_angle(T[:3, :3]))))
    assert off[0] > 8.0, "without features nothing tells"
    assert off[1] < 1.0


def test_what_lies_beside_the_model_does_not_match_along_its_normal() -> None:
    """Fails where a face that was shifted along itself matches a model that ends before it."""
    rng = np.random.default_rng(3)
    first, second = parcel(rng, 1500, 0.001), parcel(rng, 1000, 0.001)
    half = first.points[:, 0] < 0.03
    model = Model(first.points[half], first.normals[half])
    result = register(second, model, np.eye(4), None, CAMERA, RegistrationConfig())
    assert result.gate_fitness < 0.72


def test_the_gate_opens_with_the_noise_that_the_recording_has() -> None:
    """Fails where a good fit on a noisy sensor is refused in every frame."""
    rng = np.random.default_rng(4)
    first, second = parcel(rng, 1500, 0.009), parcel(rng, 1000, 0.009)
    model, c = Model(first.points, first.normals), RegistrationConfig()
    assert register(second, model, np.eye(4), None, CAMERA, c).gate_fitness < 0.8
    noise = DepthNoise()
    noise.counts[4, 14] = 1000  # at 1.1 m a difference of 7.25 mm in the median, so 7.6 mm
    assert noise.sigma(np.array([1.0])) > 2.5 * depth_sigma(1.0)
    assert register(second, model, np.eye(4), None, CAMERA, c, noise).gate_fitness > 0.8


# fusion


def test_eps_ball_needs_every_previous_cloud_and_is_open() -> None:
    """Catches any instead of every previous cloud, and <= instead of <."""
    clouds = [KdTree(np.array([[0.0, 0, 0], [1, 1, 1]])) for _ in range(5)]
    points = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.0099, 0, 0], [0.5, 0, 0]])
    assert supported(points, clouds, 0.01).tolist() == [True, False, True, False]
    clouds[2] = KdTree(np.array([[1.0, 1, 1], [2, 2, 2]]))
    assert not supported(points, clouds, 0.01).any()
    assert supported(points, [], 0.01).all()


def test_model_is_bounded_and_thinned_by_seed() -> None:
    """Catches a model without a bound, and thinning that doesn't repeat or ignores the seed."""
    rng = np.random.default_rng(0)
    points, normals = box_cloud(rng, 900)

    def fused(seed: int) -> Model:
        fusion = Fusion(FusionConfig(max_model_points=1000))
        for k in range(3):
            fusion.step(Observation(points, normals), np.eye(4), generator(seed, "fusion", k))
        assert fusion.model is not None
        return fusion.model

    assert len(fused(0).points) == 1000
    assert np.array_equal(fused(0).points, fused(0).points)
    assert not np.array_equal(fused(0).points, fused(1).points)


def test_observations_are_put_into_the_model_frame() -> None:
    """Catches the inverse transform, and normals that are not rotated."""
    points, normals = box_cloud(np.random.default_rng(0), 300)
    fusion = Fusion(FusionConfig())
    T_model_camera = at(0.1, 0, 0, (0, 0, 1.0))
    fusion.step(Observation(points, normals), T_model_camera, generator(0, "fusion", 0))
    assert fusion.model is not None
    assert np.allclose(fusion.model.points, transform(T_model_camera, points))
    assert np.allclose(fusion.model.normals, normals @ T_model_camera[:3, :3].T)


# estimation


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma_a", "rmse_mm", "to_90", "drift_mm"),
    [(0.1, 4.5, 0.54, 2.3), (0.3, 10.5, 0.31, 5.2), (1.0, 25.9, 0.18, 13.0)],
)
def test_velocity_filter_reproduces_the_measured_table(
    sigma_a: float, rmse_mm: float, to_90: float, drift_mm: float
) -> None:
    """Catches a filter whose error, rise time or drift differs by over 20 % from docs/papers.md,
    "Velocity filter".

    30 Hz, 4 mm noise, 0.2 m/s from t = 1 s on.
    """
    errors, reach, drift = [], [], []
    for trial in range(120):
        rng = np.random.default_rng(trial)
        f = VelocityFilter(EstimationConfig(sigma_acceleration=sigma_a))
        reached = None
        for k in range(150):
            t = k / 30
            x = max(0.0, t - 1) * 0.2
            e = f.step(round(t * 1e9), np.array([x, 0, 0]) + rng.normal(0, 0.004, 3))
            assert e is not None
            if reached is None and t > 1 and e.velocity[0] >= 0.18:
                reached = t - 1
            if t > 2.5:
                errors.append(e.velocity[0] - 0.2)
        reach.append(reached)
        end = f.step(round((149 / 30 + 0.5) * 1e9), None)
        assert end is not None
        drift.append(end.position[0] - e.position[0] - 0.2 * 0.5)
    assert np.sqrt(np.mean(np.square(errors))) * 1e3 == pytest.approx(rmse_mm, rel=0.2)
    assert np.mean(reach) == pytest.approx(to_90, rel=0.2)
    assert np.std(drift) * 1e3 == pytest.approx(drift_mm, rel=0.2)


def test_loss_policy_and_staleness() -> None:
    """Catches the two loss policies swapped, and an estimate stale too early or never."""

    def run(policy: str) -> list[float]:
        f = VelocityFilter(EstimationConfig(loss_policy=policy))
        for k in range(30):
            f.step(round(k / 30 * 1e9), np.array([0.2 * k / 30, 0, 0]))
        out = [f.step(round((1 + k / 30) * 1e9), None) for k in range(45)]
        assert [e.stale for e in out if e][-1]
        assert not out[10].stale
        return [float(e.position[0]) for e in out if e]

    moving, standing = run("constant_velocity"), run("zero")
    assert moving[15] - moving[0] == pytest.approx(0.1, rel=0.1)
    assert standing[15] == pytest.approx(standing[0])


def test_filter_survives_equal_stamps_and_long_pauses() -> None:
    """Catches a division by a time step of 0, and NaN after a minute."""
    f = VelocityFilter(EstimationConfig())
    for t in (0, 0, 10**9, 61 * 10**9):
        e = f.step(t, np.zeros(3))
        assert e is not None
        assert np.isfinite(e.velocity).all()


# grasps, servo, execution, schedule


def test_of_two_equal_grasps_the_nearer_wins() -> None:
    """Catches the sign of the distance: only equation 5 read literally prefers the farther one."""
    far_and_near = np.array([at(x=0.3), at(x=0.1)])
    for literal, first in ((False, 1), (True, 0)):
        metric = grasp_metric(
            far_and_near, np.array([0.8, 0.8]), np.eye(4), SelectionConfig(literal_eq5=literal)
        )
        assert by_metric(metric)[0] == first


def test_metric_closed_form_and_nan_scores() -> None:
    """Catches wrong weights, a NaN score that is chosen, and an unstable order of equal ones."""
    grasps = np.array([at(x=0.3, rotvec=(0, 0, 0.5)), np.eye(4)])
    metric = grasp_metric(grasps, np.array([0.9, np.nan]), np.eye(4), SelectionConfig())
    assert metric[0] == pytest.approx(0.9 - 0.1 * 0.3 - 0.2 * 0.5)
    assert by_metric(metric).tolist() == [0]
    assert by_metric(np.full(3, 0.4)).tolist() == [0, 1, 2]


def test_the_grasp_chosen_last_is_kept_until_another_is_better_by_the_margin() -> None:
    """Catches a margin for the wrong grasp, a metric changed in place, and a slack for all."""
    metric = np.array([0.5, 0.64, 0.4])  # the last one is the grasp chosen before
    assert by_metric(metric, 0.2).tolist() == [1, 2, 0]
    assert by_metric(metric, 0.3).tolist() == [2, 1, 0]
    assert metric.tolist() == [0.5, 0.64, 0.4]
    # only this grasp may overlap the cloud more, since its noise has changed
    assert overlap_allowed(np.array([0, 2]), 3, True, 0.004).tolist() == pytest.approx(
        [0.004, 0.010]
    )
    assert overlap_allowed(np.array([0, 2]), 3, False, 0.004).tolist() == pytest.approx(
        [0.004, 0.004]
    )


def test_servo_law_at_rest_is_proportional_plus_velocity() -> None:
    """Catches a wrong gain, and the object's velocity left out."""
    servo = Servo(ServoConfig(), FIVE_FINGERS)
    v = np.array([0.05, 0, 0])
    command = servo.step(0, at(), at(x=0.04, rotvec=(0, 0, 0.2)), at(), np.array([0, 0, 1.0]), v)
    assert np.allclose(command.twist[:3], [0.04 + 0.05, 0, 0])
    assert np.allclose(command.twist[3:], [0, 0, 2.5 * 0.2])
    assert (command.error_linear, command.error_angular) == (
        pytest.approx(0.04),
        pytest.approx(0.2),
    )


def test_a_hand_sent_beyond_the_grasp_does_not_creep_up_to_it() -> None:
    """Catches a goal not beyond the grasp, or beyond it also from behind, and a wrong error."""
    ahead = invert(T_hand_palm)[:3, 2]  # along the fingers of a palm in its own frame
    config = ServoConfig(beyond_m=0.012)
    for metres, expected in ((0.004, 0.016), (-0.004, -0.004)):  # before the grasp, and behind it
        grasp = at()
        grasp[:3, 3] = metres * ahead
        command = Servo(config, FIVE_FINGERS).step(0, at(), grasp, None, np.zeros(3), np.zeros(3))
        np.testing.assert_allclose(command.twist[:3], expected * ahead, atol=1e-12)
        assert command.error_linear == pytest.approx(0.004)  # the error stays that to the grasp


def test_beyond_the_grasp_is_along_the_hands_own_approach() -> None:
    """Fails where z of any hand's base is taken for the way along its fingers."""
    hand = replace(FIVE_FINGERS, approach=np.array([0.6, 0.0, 0.8]))
    ahead = T_hand_palm[:3, :3].T @ hand.approach
    grasp = at()
    grasp[:3, 3] = 0.004 * ahead
    servo = Servo(ServoConfig(beyond_m=0.012), hand)
    command = servo.step(0, at(), grasp, None, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(command.twist[:3], 0.016 * ahead, atol=1e-12)


@pytest.mark.parametrize(
    ("hertz", "translation_s", "rotation_s"), [(30.0, 2.43, 1.07), (100.0, 2.34, 0.96)]
)
def test_table_v_settles_in_the_time_of_figure_4(
    hertz: float, translation_s: float, rotation_s: float
) -> None:
    """Fails where the derivative is divided by the period, filtered, or has another gain: the hand
    follows its command exactly, 90 % of the way.
    """
    grasp, still = at(0.15, 0, 0, (0, 0, 0.5)), np.zeros(3)
    servo, palm, times = Servo(ServoConfig(), FIVE_FINGERS), at(), [np.inf, np.inf]
    for k in range(round(6 * hertz)):
        t = k / hertz
        command = servo.step(round(t * 1e9), palm, grasp, None, still, still)
        for n, share in enumerate((command.error_linear / 0.15, command.error_angular / 0.5)):
            times[n] = min(times[n], t) if share <= 0.1 else times[n]
        palm[:3, 3] += command.twist[:3] / hertz
        palm[:3, :3] = Rotation.from_rotvec(command.twist[3:] / hertz).as_matrix() @ palm[:3, :3]
    assert times == [
        pytest.approx(translation_s, abs=0.5 / hertz + 0.01),
        pytest.approx(rotation_s, abs=0.5 / hertz + 0.01),
    ]


def test_what_is_asked_between_periods_leaves_the_servo_as_it_is() -> None:
    """Fails where a frame's row counts as a control period: the error's difference is over less."""
    servo, still = Servo(ServoConfig(), FIVE_FINGERS), np.zeros(3)
    alone = Servo(ServoConfig(), FIVE_FINGERS)
    for k in range(4):
        grasp = at(x=0.1 - 0.01 * k)
        one, other = (
            s.step(k * 10_000_000, at(), grasp, None, still, still) for s in (servo, alone)
        )
        assert np.array_equal(one.twist, other.twist)
        servo.step(k * 10_000_000 + 3_000_000, at(), at(x=0.5), None, still, still, False)


def test_a_gap_is_no_control_period() -> None:
    """Fails where the change of the error over a gap of seconds kicks the hand at once."""
    servo, still = Servo(ServoConfig(), FIVE_FINGERS), np.zeros(3)
    servo.step(0, at(), at(x=0.3), None, still, still)
    after = servo.step(3_000_000_000, at(), at(x=0.1), None, still, still)
    assert after.twist[0] == pytest.approx(0.1)
    soon = servo.step(3_010_000_000, at(), at(x=0.09), None, still, still)
    assert soon.twist[0] == pytest.approx(0.09 - 2.0 * 0.01)


def test_orientation_blends_from_object_to_grasp() -> None:
    """Catches far and near swapped, and a blend that is not linear."""
    c = ServoConfig()
    r_O, r_G = np.array([0.4, 0, 0]), np.array([0, 0.2, 0])
    assert np.allclose(blend_rotation(0.25, r_O, r_G, c), r_O)
    assert np.allclose(blend_rotation(0.03, r_O, r_G, c), r_G)
    assert np.allclose(blend_rotation(0.125, r_O, r_G, c), (r_O + r_G) / 2)


def test_look_at_turns_the_optical_axis_to_the_target() -> None:
    """Catches another camera axis than z, and a rotation in the wrong direction."""
    r = look_at_rotation(at(), np.array([1.0, 0, 1.0]))
    assert np.allclose(Rotation.from_rotvec(r).apply([0, 0, 1]), np.array([1, 0, 1]) / np.sqrt(2))
    assert np.allclose(look_at_rotation(at(), np.array([0, 0, 2.0])), 0)


def test_execution_threshold_is_strict() -> None:
    """Catches >= instead of >, and an execution without a score."""
    c = ExecutionConfig()
    assert execute(0.7, 0.7, c, None, np.eye(4)) is False
    assert execute(0.71, 0.7, c, None, np.eye(4)) is True
    assert execute(None, 0.7, c, None, np.eye(4)) is None


def test_latency_delays_by_whole_frames() -> None:
    """Catches a result that is usable before its latency has passed."""
    delayed: Delayed[int] = Delayed(0.05)
    usable = [delayed.step(round(k / 30 * 1e9), k) for k in range(5)]
    assert [u[1] if u else None for u in usable] == [None, None, 0, 1, 2]
    assert Delayed(0.0).step(0, 7) == (0, 7)


def test_pose_helper_is_right_handed() -> None:
    """Catches a matrix of a pose that is a reflection."""
    assert np.linalg.det(
        matrix_from_pose(np.array([0, 0, 0, 0.1, 0.2, 0.3, 0.9]))[:3, :3]
    ) == pytest.approx(1)


def test_what_is_hidden_by_something_nearer_does_not_speak_against_the_pose() -> None:
    """Fails where a mug's back wall, which its front hides, makes a right pose a bad one; and where
    a model that stands in front of what is seen, or behind it, agrees.
    """
    rows, columns = np.mgrid[90:150:2, 130:190:2]
    config = TrackingConfig(iterations=1)
    none = Features(np.zeros((0, 3)), np.zeros((0, 2)))
    window = (100, 60, 220, 180)
    depth = np.full((120, 120), 0.5, np.float32)

    def agree(*z: float) -> tuple[float, int]:
        walls = [
            CAMERA.backproject(
                columns.ravel().astype(float), rows.ravel().astype(float), np.full(rows.size, d)
            )
            for d in z
        ]
        points = np.concatenate(walls)
        model = Model(points, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
        free = np.ones(depth.shape, dtype=bool)
        _, share, n, _ = align.align_to_image(
            depth, window, free, model, none, np.eye(4), CAMERA, config
        )
        return share, n

    assert agree(0.5, 0.56)[0] == 1.0
    assert agree(0.46)[0] == 0.0
    assert agree(0.56) == (0.0, 0), "all of it is hidden: nothing is compared"
