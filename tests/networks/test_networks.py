"""Catches wrong layers of FFHNet, checkpoints that run code, and grasps in a wrong frame.

Wrong layers are parts in another order, and a slope or a norm left out.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from dgeval.config import Config, ExecutionConfig, GraspsConfig, load_config
from dgeval.errors import UsageError
from dgeval.geometry import Array, increment, invert, rotation_angle
from dgeval.networks import checkpoints
from dgeval.networks.bps import basis, encode
from dgeval.networks.checkpoints import LEVELS, read_weights
from dgeval.networks.ffhnet import (
    FFHEvaluator,
    FFHGenerator,
    Palms,
    load_evaluator,
    load_generator,
    matrix_from_6d,
)
from dgeval.paper_values import GIVEN, OURS, departure_note, departures
from dgeval.planning.execution import execute
from dgeval.planning.grasps import (
    approach_free,
    encode_cloud,
    evaluate,
    free_of,
    networks_of,
    propose,
)
from dgeval.planning.hand_overlap import standing_points
from dgeval.planning.reachability import Arm, arm_of
from dgeval.planning.recorded_arm import RecordedArm, recorded_arm
from dgeval.recording.messages import JointSample
from dgeval.recording.robot import JointTrack
from dgeval.robots.diana7 import LOWER, UPPER, ArmKinematics
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.robots.dlr_hit_hand import T_hand_camera
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.simulation.perception import PerceivedObject
from dgeval.simulation.proposals import FFHNetGrasps
from dgeval.simulation.scenario import load_scenario
from dgeval.training.ship import export
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

SIZE = (64, 24, 16)  # basis points, width, hidden: small, and all different


def with_fixed_weights(network: nn.Module, scale: float = 0.3) -> Any:
    """The network with random weights that depend on name and shape alone, in eval mode."""
    for name, tensor in network.state_dict().items():
        if tensor.dtype.is_floating_point:
            rng = np.random.default_rng(int(hashlib.sha256(name.encode()).hexdigest()[:8], 16))
            value = rng.normal(0, scale, tensor.shape)
            tensor.copy_(
                torch.from_numpy(np.abs(value) + 0.5 if name.endswith("running_var") else value)
            )
    return network.eval()


def random_inputs(n: int, n_bps: int) -> tuple[Tensor, Palms]:
    """Random inputs: bps (1, n_bps) and n palms."""
    torch.manual_seed(3)
    return torch.rand(1, n_bps) * 0.3, Palms(
        matrix_from_6d(torch.randn(n, 6)), 0.1 * torch.randn(n, 3), torch.rand(n, 15)
    )


# clouds


def test_basis_is_the_published_one() -> None:
    """Catches another seed, order of draws or radius; the digest is of the authors' own file."""
    digest = hashlib.sha256(basis(4096, 0.2).tobytes()).hexdigest()
    assert digest == "d1e7f6d38deb013a1521a526aa846e9666e95cbff00158edc4dab337c8d334ef"


def test_encoding_is_the_distance_to_the_nearest_point() -> None:
    """Catches squared distances, distances of the cloud's points, and an empty cloud accepted."""
    rng = np.random.default_rng(0)
    cloud = rng.normal(0, 0.05, (300, 3))
    exact = np.linalg.norm(basis(200)[:, None].astype(float) - cloud[None], axis=2).min(axis=1)
    np.testing.assert_allclose(encode(cloud, basis(200)), exact, atol=1e-7)
    with pytest.raises(ValueError, match="empty"):
        encode(np.empty((0, 3)), basis(200))


@pytest.mark.parametrize("name", ["cheez_it", "mustard_bottle", "soft_scrub"])
def test_encodings_of_real_clouds_are_the_authors(name: str, real_data: Path) -> None:
    """Catches another scale or another basis than in the authors' files of three clouds."""
    with np.load(real_data / "ffhnet_clouds" / f"{name}.npz") as file:
        np.testing.assert_allclose(encode(file["points"], basis()), file["bps"].ravel(), atol=1e-6)


# networks against a second implementation in NumPy, from the published description


def leaky(x: Array) -> Array:
    return np.where(x > 0, x, 0.2 * x)


class Reference:
    """Layers of a state dict, computed in double precision."""

    def __init__(self, network: nn.Module) -> None:
        self.w = {k: v.numpy().astype(float) for k, v in network.state_dict().items()}

    def linear(self, name: str, x: Array) -> Array:
        return np.asarray(x @ self.w[f"{name}.weight"].T + self.w[f"{name}.bias"])

    def norm(self, name: str, x: Array) -> Array:
        mean, var = self.w[f"{name}.running_mean"], self.w[f"{name}.running_var"]
        return np.asarray(
            (x - mean) / np.sqrt(var + 1e-5) * self.w[f"{name}.weight"] + self.w[f"{name}.bias"]
        )

    def block(self, name: str, x: Array) -> Array:
        skip = leaky(self.linear(f"{name}.fc3", x))
        main = self.norm(
            f"{name}.bn2",
            self.linear(
                f"{name}.fc2", leaky(self.norm(f"{name}.bn1", self.linear(f"{name}.fc1", x)))
            ),
        )
        return leaky(skip + main)


def test_generator_is_as_described() -> None:
    """Catches parts in another order, a missing norm or slope, and wrong rotation columns."""
    network = with_fixed_weights(FFHGenerator(*SIZE))
    bps, palms = random_inputs(7, SIZE[0])
    ref = Reference(network)
    bps_rows = np.tile(bps.numpy().astype(float), (7, 1))
    x = ref.norm(
        "enc_bn1",
        np.concatenate(
            [bps_rows, palms.rotation.numpy().reshape(7, 9), palms.translation, palms.joints],
            axis=1,
        ),
    )
    code = ref.block("enc_rb2", np.concatenate([x, ref.block("enc_rb1", x)], axis=1))
    z = torch.randn(7, 5)
    x0 = np.concatenate([z.numpy(), ref.norm("dec_bn1", bps_rows)], axis=1)
    out = ref.block("dec_rb2", np.concatenate([x0, ref.block("dec_rb1", x0)], axis=1))
    with torch.no_grad():
        # one row for all candidates, and a row for each
        for given_bps in (bps, bps.expand(7, -1)):
            mu, logvar = network.encode(given_bps, palms)
            np.testing.assert_allclose(mu, ref.linear("enc_mu", code), atol=1e-5)
            np.testing.assert_allclose(logvar, ref.linear("enc_logvar", code), atol=1e-5)
            decoded = network.decode(z, given_bps)
            np.testing.assert_allclose(
                decoded.translation, ref.linear("dec_transl", out), atol=1e-5
            )
            np.testing.assert_allclose(decoded.joints, ref.linear("dec_joint_conf", out), atol=1e-5)
    six = ref.linear("dec_rot", out)
    a = six[:, :3] / np.linalg.norm(six[:, :3], axis=1, keepdims=True)
    c = np.cross(a, six[:, 3:])
    c /= np.linalg.norm(c, axis=1, keepdims=True)
    np.testing.assert_allclose(
        decoded.rotation, np.stack([a, np.cross(c, a), c], axis=2), atol=1e-5
    )


@pytest.mark.parametrize("joints", [False, True])
def test_evaluator_is_as_described(joints: bool) -> None:
    """Catches parts in another order, a missing norm, and joints used by the published network."""
    network = with_fixed_weights(FFHEvaluator(*SIZE, joints=joints), 0.2)
    bps, palms = random_inputs(7, SIZE[0])
    ref = Reference(network)
    parts = [
        np.tile(bps.numpy().astype(float), (7, 1)),
        palms.rotation.numpy().reshape(7, 9),
        palms.translation.numpy(),
    ]
    x = ref.norm("bn1", np.concatenate([*parts, palms.joints.numpy()] if joints else parts, axis=1))
    out = ref.block("rb1", x)
    for name in ("rb2", "rb3"):  # the previous block's output is first here, last in the generator
        out = ref.block(name, np.concatenate([out, x], axis=1))
    expected = 1 / (1 + np.exp(-ref.linear("out_success", out)[:, 0]))
    with torch.no_grad():
        for given_bps in (bps, bps.expand(7, -1)):
            np.testing.assert_allclose(network(given_bps, palms), expected, atol=1e-5)
        other = network(bps, Palms(palms.rotation, palms.translation, palms.joints + 0.3))
    # the published network does not see the joints
    assert bool(np.abs(other.numpy() - expected).max() > 1e-3) == joints


def test_published_sizes() -> None:
    """Catches defaults that are not the published sizes, by numbers of parameters and shapes."""
    generator, evaluator = FFHGenerator(), FFHEvaluator()
    assert sum(p.numel() for p in generator.parameters()) == 13_987_928
    assert sum(p.numel() for p in evaluator.parameters()) == 10_661_657
    shapes = {k: tuple(v.shape) for k, v in generator.state_dict().items()}
    assert shapes["enc_rb2.fc3.weight"] == (512, 4635)
    assert shapes["dec_rb1.fc1.weight"] == (256, 4101)
    assert {k: tuple(v.shape) for k, v in evaluator.state_dict().items()}["rb3.fc1.weight"] == (
        256,
        4620,
    )


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_six_numbers_make_a_rotation(six: list[float]) -> None:
    """Catches a matrix that is not orthonormal, is left-handed, or has rows for columns."""
    a, b = np.array(six[:3]), np.array(six[3:])
    if np.linalg.norm(np.cross(a, b)) < 1e-2 * max(np.linalg.norm(a), np.linalg.norm(b), 1):
        return
    R = matrix_from_6d(torch.tensor([six], dtype=torch.float64))[0].numpy()
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R[:, 0], a / np.linalg.norm(a), atol=1e-9)


# checkpoints


class RunsACommand:
    """An object whose pickle calls os.system."""

    def __reduce__(self) -> Any:
        return os.system, ("echo a checkpoint ran this",)


@pytest.mark.parametrize("legacy", [False, True])
def test_the_authors_containers_load(tmp_path: Path, legacy: bool) -> None:
    """Catches a format, a prefix or an object beside the weights that is refused; cut-off files."""
    network = with_fixed_weights(FFHGenerator(*SIZE))
    optimiser = torch.optim.Adam(network.parameters())
    plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(optimiser)
    content = {
        "epoch": 10,
        "ffhgenerator_state_dict": {f"module.{k}": v for k, v in network.state_dict().items()},
        "optim_ffhgenerator_state_dict": optimiser.state_dict(),
        "scheduler_ffhgenerator_state_dict": plateau.__dict__ | {"optimizer": None},
    }
    path = tmp_path / "10_gen_net.pt"
    torch.save(content, path, _use_new_zipfile_serialization=not legacy)
    loaded = load_generator(path)
    z, (bps, _) = torch.randn(4, 5), random_inputs(1, SIZE[0])
    with torch.no_grad():
        np.testing.assert_allclose(
            loaded.decode(z, bps).joints, network.decode(z, bps).joints, atol=1e-6
        )

    path.write_bytes(path.read_bytes()[:-3000])
    with pytest.raises(UsageError, match=r"can't be read|safe to read"):
        load_generator(path)
    with pytest.raises(UsageError, match="no such file"):
        load_generator(tmp_path / "none.pt")


@pytest.mark.parametrize("legacy", [False, True])
def test_a_checkpoint_runs_nothing(
    tmp_path: Path, legacy: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    """Catches code that a pickle runs while it is loaded."""
    path = tmp_path / "bad.pt"
    torch.save(
        {"ffhevaluator_state_dict": {"bn1.weight": torch.ones(3)}, "more": RunsACommand()},
        path,
        _use_new_zipfile_serialization=not legacy,
    )
    with pytest.raises(UsageError, match="system is refused"):
        read_weights(path, "ffhevaluator_state_dict")
    assert "ran this" not in capfd.readouterr().out
    (tmp_path / "plain.pt").write_bytes(pickle.dumps(RunsACommand()))
    with pytest.raises(UsageError):
        read_weights(tmp_path / "plain.pt")


def test_a_published_file_is_known_by_its_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches recognition by name or size, not by content."""
    known, other = tmp_path / "a.pt", tmp_path / "b.pt"
    known.write_bytes(b"published")
    other.write_bytes(b"publishes")
    monkeypatch.setitem(
        checkpoints.PUBLISHED, hashlib.sha256(b"published").hexdigest(), "the published one"
    )
    assert checkpoints.published(known) == "the published one"
    assert checkpoints.published(other) is None


def test_wrong_weights_are_named(tmp_path: Path) -> None:
    """Catches missing, unknown or misshapen weights that load, and errors that don't name them."""
    weights = with_fixed_weights(FFHEvaluator(*SIZE)).state_dict()
    for change, match in (
        ({"rb2.fc1.weight": None}, "rb2.fc1.weight is missing"),
        ({"rb2.fc1.weight": torch.ones(2, 2)}, "rb2.fc1.weight has shape"),
        ({"rb9.fc1.weight": torch.ones(2)}, "rb9.fc1.weight is not a part"),
        ({"bn1.weight": None}, "bn1.weight is missing"),
    ):
        state = {k: v for k, v in {**weights, **change}.items() if v is not None}
        torch.save({"ffhevaluator_state_dict": state}, tmp_path / "a.pt")
        with pytest.raises(UsageError, match=match):
            load_evaluator(tmp_path / "a.pt")
    torch.save({"other": 1}, tmp_path / "b.pt")
    with pytest.raises(UsageError, match="there is: other"):
        load_evaluator(tmp_path / "b.pt")
    small = tmp_path / "small_eva_net.pt"
    torch.save({"ffhevaluator_state_dict": weights}, small)
    with pytest.raises(UsageError, match="basis points"):
        networks_of(GraspsConfig(evaluator=str(small)))


# the grasp stage


def half_shell(seed: int = 0) -> Array:
    """Points (n, 3) m on side and top of an upright cylinder, 7 cm in diameter and 12 cm tall.

    They are in the frame of a camera 0.4 m above its top that looks straight down.
    """
    rng = np.random.default_rng(seed)
    angle, height = rng.uniform(0, 2 * np.pi, 1500), rng.uniform(0.0, 0.12, 1500)
    side = np.stack([0.035 * np.cos(angle), 0.035 * np.sin(angle), 0.4 + height], axis=1)
    r, turn = 0.035 * np.sqrt(rng.uniform(0, 1, 700)), rng.uniform(0, 2 * np.pi, 700)
    return np.concatenate(
        [side[:800], np.stack([r * np.cos(turn), r * np.sin(turn), np.full(700, 0.4)], axis=1)]
    )


def test_grasps_go_along_with_the_cloud_and_repeat() -> None:
    """Catches a mean not added back, draws that don't repeat, and scores of other poses."""
    networks = networks_of(GraspsConfig())
    cloud = half_shell()
    here = propose(encode_cloud(cloud, networks), networks, 64, 0, 5)
    again = propose(encode_cloud(cloud, networks), networks, 64, 0, 5)
    np.testing.assert_array_equal(here.T_cloud_palm, again.T_cloud_palm)
    assert (
        np.abs(
            propose(encode_cloud(cloud, networks), networks, 64, 0, 6).T_cloud_palm
            - here.T_cloud_palm
        ).max()
        > 1e-3
    )
    step = np.array([0.1, -0.05, 0.2])
    there = propose(encode_cloud(cloud + step, networks), networks, 64, 0, 5)
    np.testing.assert_allclose(
        there.T_cloud_palm[:, :3, 3], here.T_cloud_palm[:, :3, 3] + step, atol=1e-5
    )
    np.testing.assert_allclose(there.scores, here.scores, atol=1e-4)
    # the score of a candidate's own pose is the candidate's score
    encoded = encode_cloud(cloud, networks)
    np.testing.assert_allclose(
        evaluate(encoded, networks, here.T_cloud_palm, here.joints), here.scores, atol=1e-5
    )


def test_the_far_side_of_what_stands_is_not_free() -> None:
    """Catches hands accepted in an object's unseen part, and a support plane of the wrong side."""
    rng = np.random.default_rng(0)
    # a block 10 cm high, seen from above
    top = np.column_stack([rng.uniform(-0.05, 0.05, (800, 2)), np.full(800, 0.10)])
    normal, offset = np.array([0.0, 0.0, 1.0]), 0.0
    under = standing_points(top, normal, offset)
    assert under[:, 2].min() > 0.0
    assert under[:, 2].max() < 0.10
    assert np.abs(under[:, :2]).max() < 0.06
    # the points fill the block: no place in it is farther than 12 mm from one of them
    inside = rng.uniform([-0.045, -0.045, 0.01], [0.045, 0.045, 0.08], (200, 3))
    assert cKDTree(under).query(inside)[0].max() < 0.012
    turned = Rotation.from_euler("xyz", [0.4, -0.3, 1.0]).as_matrix()
    again = standing_points(
        top @ turned.T + 0.3, turned @ normal, offset + 0.3 * float((turned @ normal).sum())
    )
    height = (again - 0.3) @ turned @ normal
    assert height.min() > 0.0
    assert height.max() < 0.10
    networks = networks_of(GraspsConfig())
    cloud = half_shell()
    drawn = propose(encode_cloud(cloud, networks), networks, 256, 0, 5)
    plane = (np.array([0.0, 0.0, -1.0]), -0.52)  # z points down; the table is 12 cm below the top
    before, after = (
        free_of(
            encode_cloud(cloud, networks, support), drawn.T_cloud_palm, drawn.joints, plane, 0.004
        )
        for support in (None, plane)
    )
    assert not (after & ~before).any()
    assert after.sum() < before.sum()


def test_an_approach_through_the_object_is_not_free() -> None:
    """Catches an approach checked behind the grasp, beyond the hand, or though it is turned off."""
    networks = networks_of(GraspsConfig())
    grid = np.stack(np.meshgrid(*[np.linspace(-0.03, 0.03, 13)] * 3), axis=-1).reshape(-1, 3)
    cloud = encode_cloud(grid, networks)
    pose = np.eye(4)
    pose[0, 3] = 0.30  # well beside the block
    joints, config = np.zeros(15), GraspsConfig(way_m=0.06)
    assert free_of(cloud, pose[None], joints[None], None, 0.004).all()
    # from its own side
    assert approach_free(cloud, pose, joints, np.array([0.6, 0.0, 0.0]), None, config)
    # from the block's side; 6 cm nearer to the block is still free
    assert approach_free(cloud, pose, joints, np.array([-0.6, 0.0, 0.0]), None, config)
    through = config.model_copy(update={"way_m": 0.45})
    # a step of the approach lies in the block
    assert not approach_free(cloud, pose, joints, np.array([-0.6, 0.0, 0.0]), None, through)
    # the approach is checked no farther than the hand is away
    assert approach_free(cloud, pose, joints, np.array([0.25, 0.0, 0.0]), None, through)
    assert approach_free(cloud, pose, joints, pose[:3, 3], None, through)
    assert approach_free(cloud, pose, joints, np.array([-0.6, 0.0, 0.0]), None, GraspsConfig())


def test_shipped_networks_know_a_grasp_from_a_hand_in_the_air() -> None:
    """Catches shipped weights that are loaded wrongly, or used with another frame or basis."""
    networks = networks_of(GraspsConfig())
    cloud = encode_cloud(half_shell(), networks)
    drawn = propose(cloud, networks, 256, 0, 0)
    best = int(np.argmax(drawn.scores))
    assert drawn.scores[best] > 0.5
    assert np.linalg.norm(drawn.T_cloud_palm[:, :3, 3] - cloud.mean, axis=1).max() < 0.3
    raised = drawn.T_cloud_palm[best].copy()
    raised[2, 3] -= 0.2
    assert evaluate(cloud, networks, raised[None], drawn.joints[best][None])[0] < 0.1


@pytest.mark.parametrize("upright", [True, False])
def test_upright_grasps_do_not_turn_with_the_camera(upright: bool) -> None:
    """Catches clouds in the camera's axes given to weights that were trained with z down.

    Grasps then fall into the table.
    """
    shipped = networks_of(GraspsConfig())
    assert shipped.upright  # from the file's metadata
    source = FFHNetGrasps(replace(shipped, upright=upright), GraspsConfig(support_z=0.0), 0, 0)
    T_base_object, held = np.eye(4), []
    T_base_object[:3, 3] = (0.5, 0.1, 0.04)
    cloud = T_base_object[:3, 3] + np.array([1, -1, -1]) * (half_shell() - [0, 0, 0.44])
    for tilt in (0.0, 60.0):
        T_base_camera = np.eye(4)
        T_base_camera[:3, :3] = Rotation.from_euler(
            "xz", [180 + tilt, 40], degrees=True
        ).as_matrix()
        T_base_camera[:3, 3] = (0.5, 0.1, 0.5)
        proposals = source.propose(
            0, PerceivedObject(T_base_object, cloud), T_base_object, T_base_camera, None
        )
        assert proposals is not None
        free = proposals.free(np.arange(len(proposals.scores)))
        held.append((proposals.T_object_palm, proposals.scores, free))
        # the score of a candidate's own pose is the candidate's score, whatever the axes
        k = int(np.argmax(proposals.scores))
        own = source.score(
            proposals, k, T_base_object, T_base_object @ proposals.T_object_palm[k], np.eye(4)
        )
        assert own == pytest.approx(proposals.scores[k], abs=1e-4)
    (first, _, free), (second, _, also) = held
    assert np.allclose(first, second, atol=1e-6) == upright
    if upright:
        assert np.array_equal(free, also)
        assert free.mean() > 0.3


# reachability

HOME = np.array([0.0, 0.3, 0.0, 1.6, 0.0, 0.5, 0.0])  # over the belt, fingers down


def test_arm_of_the_description_is_the_arm() -> None:
    """Catches a wrong frame, axis or joint limit in the arm that is read from the description, and
    a search that gives up on what is in reach, from any pose.

    The reference is MuJoCo's kinematics of the same arm.
    """
    description = load_description(robot_urdf(T_hand_camera, FIVE_FINGERS), "arm", (), 0.012)
    palm = next(link for link in description.joints if "palm" in link)
    arm = arm_of(description, "base_link", palm)
    assert isinstance(arm, Arm)
    kinematics = ArmKinematics(FIVE_FINGERS.T_hand_palm)
    rng = np.random.default_rng(1)
    np.testing.assert_allclose([j.lower for j in arm.movable], LOWER, atol=1e-6)
    for _ in range(240):
        q = rng.uniform(LOWER + 0.1, UPPER - 0.1)
        T, J = arm.palm(q)
        np.testing.assert_allclose(T, kinematics.palm(q), atol=1e-6)
        moved = arm.palm(q + 1e-6 * np.eye(7)[3])[0]
        np.testing.assert_allclose((moved - T)[:3, 3] / 1e-6, J[:3, 3], atol=1e-4)
        solved = arm.solve(T, HOME)
        assert solved is not None, "every pose of joints within their limits is in reach"
        assert ((solved >= LOWER - 1e-9) & (solved <= UPPER + 1e-9)).all()
        off = invert(arm.palm(solved)[0]) @ T
        assert np.linalg.norm(off[:3, 3]) < 1e-3
        assert rotation_angle(off[:3, :3]) < 0.0101
    far = np.eye(4)
    far[:3, 3] = (2.5, 0, 0.3)
    assert arm.solve(far, np.zeros(7)) is None


def test_an_arm_that_stands_in_a_world_is_asked_in_its_own_frame() -> None:
    """Catches an arm that reaches everything because the base's frame is not in its description,
    and a reason that is not told.
    """
    text = robot_urdf(T_hand_camera, FIVE_FINGERS)
    description = load_description(text, "arm", (), 0.012)
    palm = next(link for link in description.joints if "palm" in link)
    arm = arm_of(description, "world", palm)
    assert isinstance(arm, Arm)
    assert arm.base == "base_link"
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    turned[:3, 3] = (1.0, 2.0, 0.5)
    tree = SimpleNamespace(
        lookup=lambda target, source, t: {("base_link", "world"): turned}.get((target, source))
    )
    track = JointTrack.of(
        [JointSample(0, {j.name: q for j, q in zip(arm.movable, HOME, strict=True)})], 0
    )
    robot: Any = SimpleNamespace(
        description=description, base_frame="world", palm_frame=palm, tree=tree, joints=track
    )
    assert recorded_arm(robot) == arm
    reaches = RecordedArm(robot, 0.5).reaches
    near = arm.palm(HOME)[0]
    assert reaches(0, invert(turned) @ near)
    assert not reaches(0, near)
    now = RecordedArm(robot, 0.5).at(0)
    assert now is not None
    assert now.room(near) is None
    assert now.room(invert(turned) @ near) == pytest.approx(arm.room(HOME), abs=1e-3)
    low, high = (np.array([getattr(j, e) for j in arm.movable]) for e in ("lower", "upper"))
    assert arm.room((low + high) / 2) == pytest.approx(1.0)
    assert arm.room(np.append(high[:-1] / 2 + low[:-1] / 2, high[-1])) == pytest.approx(0.0)
    assert arm.room((3 * low + high) / 4) == pytest.approx(0.5)
    robot.tree = SimpleNamespace(lookup=lambda *_: None)
    assert recorded_arm(robot) == "nothing says where its base 'base_link' is in 'world'"
    robot.joints = JointTrack()
    assert recorded_arm(robot) == "its joint 'arm_1' is not recorded"
    assert arm_of(description, "base_link", "tool") == (
        "the description has no joint that carries 'tool'"
    )


def test_what_is_not_in_the_paper_is_named() -> None:
    """Catches a rule of ours that is not reported, and one that is reported but not in use."""
    every = ("observation", "registration", "fusion", "selection", "servo", "execution", "vfas")
    assert departures(Config(), every) == [
        "vfas.noise_candidates = top8 (paper: all)",
        "registration.colour = True (ours)",
        "vfas.keep_seed = True (ours)",
    ]
    belt = load_scenario("conveyor").pipeline
    assert departures(belt, ("selection", "servo", "execution")) == [
        "selection.keep_margin = 0.15 (ours)",
        "servo.beyond_m = 0.012 (ours)",
        "execution.arrived_m = 0.005 (ours)",
    ]
    other = load_config("dynamic", ("fusion.n_s=3",))
    (note,) = departure_note(other, ("fusion",))
    assert note == "not as in the paper: fusion.n_s = 3 (paper: 5)"
    assert departure_note(Config(), ("fusion",)) == []
    for name in (*GIVEN, *OURS):  # a renamed parameter would be left out of every note
        section, key = name.split(".")
        assert key in type(getattr(Config(), section)).model_fields, name


def test_a_hand_on_its_way_is_not_executed() -> None:
    """Catches execution far from the grasp, a distance rule that is not set, degrees for radians.

    Our rule executes at the grasp only. The paper's goes by score alone, and holds if no distance
    is set.
    """
    T = np.eye(4)
    near, far, turned = (
        increment(np.array([0.007, 0, 0, 0, 0, 0])),
        increment(np.array([0.009, 0, 0, 0, 0, 0])),
        np.eye(4),
    )
    turned[:3, :3] = Rotation.from_euler("y", 7, degrees=True).as_matrix()
    paper, ours = ExecutionConfig(c_e=0.5), ExecutionConfig(c_e=0.5, arrived_m=0.008)
    assert [execute(0.6, 0.7, paper, p, T) for p in (near, far, turned, None)] == [True] * 4
    assert [execute(0.6, 0.7, ours, p, T) for p in (near, far, turned, None)] == [
        True,
        False,
        False,
        None,
    ]
    assert execute(0.5, 0.7, ours, near, T) is False
    assert execute(None, 0.7, paper, near, T) is None


def test_whole_steps_keep_the_weights(tmp_path: Path) -> None:
    """Catches steps per column, not per row, and files without the note that clouds are upright."""
    torch.manual_seed(0)
    network = FFHEvaluator(32, 16, 8).eval()
    export(network, tmp_path / "ffhnet_evaluator.safetensors")
    loaded = load_evaluator(tmp_path / "ffhnet_evaluator.safetensors")
    assert loaded.upright
    for name, tensor in network.state_dict().items():
        tolerance = (
            0.5 / LEVELS * tensor.abs().amax(1, keepdim=True)
            if tensor.ndim == 2
            else torch.zeros(1)
        )
        assert ((loaded.state_dict()[name] - tensor).abs() <= tolerance * 1.001).all(), name
