"""Catches labels that don't come from physics, views in a wrong frame, and wrongly resumed runs."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from dgeval.geometry import invert, transform
from dgeval.networks.bps import basis
from dgeval.networks.ffhnet import load_evaluator as load_ffhnet_evaluator
from dgeval.networks.ffhnet import palms_of
from dgeval.networks.pointnet2 import VFAS, load_evaluator
from dgeval.parallel import write_all
from dgeval.simulation.clouds import seen_from
from dgeval.simulation.grasps import FlyingHand
from dgeval.training import ffhnet, loop, vfas
from dgeval.training.ffhnet import Settings, batch_of, load_objects
from dgeval.training.grasp_data import (
    HAND,
    MAX_PENETRATION,
    SHORT_M,
    SHORT_SD,
    holds,
    make_grasps,
    read_grasps,
    write_grasps,
)
from dgeval.training.jaw_data import write_scenes
from dgeval.training.ship import export, scores_of
from dgeval.training.views import camera_at, views_of
from dgeval.worlds.objects import procedural_object, surface_points, ten_objects

SMALL = Settings(
    n_bps=64,
    width=24,
    hidden=16,
    views=4,
    held_out=2,
    batch=64,
    steps=12,
    generator_steps=12,
    tune_steps=4,
)


@pytest.fixture(scope="module")
def grasps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of files with a few tried grasps for each of six objects."""
    out = tmp_path_factory.mktemp("train") / "grasps"
    write_all(partial(write_grasps, out=out, seed=0, tried=12), range(6), 1, lambda _: None)
    return out


@pytest.mark.slow
def test_grasps_are_tried_in_physics_and_repeat(grasps: Path) -> None:
    """Catches draws that don't repeat, labels that are all alike, and palms far from the object."""
    object_model = procedural_object(1, 0)
    once = make_grasps(object_model, 0, 12)
    again = read_grasps(grasps / f"{object_model.name}.npz")
    np.testing.assert_allclose(once.T_object_palm, again.T_object_palm, atol=1e-6)
    np.testing.assert_array_equal(once.held, again.held)
    assert 0 < once.held.sum() < len(once.held)
    assert not (once.held & once.overlapping).any()
    # a hand that held has its palm near the object
    palms = once.T_object_palm[once.held]
    assert np.linalg.norm(palms[:, :3, 3], axis=1).max() < 0.25


def test_a_camera_sees_the_near_side_only() -> None:
    """Catches a camera that sees through the object, and points measured far from the surface."""
    baseball = ten_objects()["baseball"]
    # as many points as in training; with fewer the camera looks through holes
    surface = surface_points(baseball, 12_000, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    for _ in range(5):
        T = camera_at(rng.uniform(0, 1.3), rng.uniform(0, 6.3), rng)
        rows, measured = seen_from(surface, T, rng)
        exact = transform(T, surface)
        far_side = (exact[rows, 2] > exact[:, 2].mean() + 0.012).mean()
        assert far_side < 0.03  # of a ball, beyond its rim
        assert 0.25 < len(rows) / len(surface) < 0.6
        assert np.median(np.linalg.norm(measured - exact[rows], axis=1)) < 0.002


def test_a_view_is_centred_and_its_encoding_belongs_to_it() -> None:
    """Catches an encoding in another frame than T_view_object, a mean kept, and z not down."""
    sugar_box = ten_objects()["sugar_box"]
    surface = surface_points(sugar_box, 4000, np.random.default_rng(0))
    for view in views_of(sugar_box, 4, 128, 0):
        placed = transform(view.T_view_object, surface)
        # the distance to the whole surface is at most that to its visible part, apart from noise
        to_surface = np.linalg.norm(basis(128)[:, None] - placed[None], axis=2).min(axis=1)
        assert (view.bps > to_surface - 0.025).all()
        assert np.median(view.bps - to_surface) > -0.002
        assert np.linalg.norm(placed.mean(axis=0)) < 0.09
        assert view.T_view_object[2, 2] < -0.25  # z down, however the camera was held


@pytest.mark.slow
def test_a_batch_keeps_palm_and_cloud_together(grasps: Path) -> None:
    """Catches a palm in another view's frame, a wrong label, and far hands that are not raised."""
    objects = load_objects(grasps, SMALL, 6, 0)
    bps, palms, label = batch_of(objects, 200, {"held": 0.5, "far": 0.5}, np.random.default_rng(0))
    for k in range(0, 200, 9):
        owner = next(o for o in objects if any(torch.equal(b, bps[k]) for b in o.bps))
        view = next(v for v, b in enumerate(owner.bps) if torch.equal(b, bps[k]))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = palms.rotation[k], palms.translation[k]
        T_object_palm = invert(owner.T_view_object[view]) @ T
        same_rotation = (
            np.abs(owner.T_object_palm[:, :3, :3] - T_object_palm[:3, :3]).max(axis=(1, 2)) < 1e-4
        )
        assert same_rotation.any()
        raised = T_object_palm[2, 3] - owner.T_object_palm[same_rotation][:, 2, 3]
        assert (np.abs(raised).min() < 1e-4) if label[k] else (raised.max() > 0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["generator", "evaluator_fingers"])
def test_a_resumed_run_ends_like_an_uninterrupted_one(
    grasps: Path, tmp_path: Path, kind: ffhnet.Kind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches draws that depend on earlier steps, and a checkpoint that lacks part of the state."""
    objects = load_objects(grasps, SMALL, 6, 0)[:3]
    uninterrupted = ffhnet.train(kind, objects, SMALL, tmp_path / "whole", lambda *_: None)
    monkeypatch.setattr(loop, "SAVE_EVERY", 5)

    class StoppedError(Exception):
        pass

    def stop(step: int, _: object) -> None:
        if step == 7:
            raise StoppedError

    with pytest.raises(StoppedError):
        ffhnet.train(kind, objects, SMALL, tmp_path / "part", stop)
    steps: list[int] = []
    resumed = ffhnet.train(
        kind, objects, SMALL, tmp_path / "part", lambda step, _: steps.append(step)
    )
    assert steps[0] == 6
    for name, tensor in uninterrupted.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name


@pytest.mark.slow
def test_an_evaluator_is_tuned_on_what_it_would_choose(grasps: Path, tmp_path: Path) -> None:
    """Catches choices mixed with other grasps, wrong labels, and cloud weights that change."""
    generator_file, first = (
        tmp_path / "generator.safetensors",
        tmp_path / "first_fingers.safetensors",
    )
    export(ffhnet.new_network("generator", SMALL), generator_file)
    export(ffhnet.new_network("evaluator_fingers", SMALL), first)
    chosen = tmp_path / "chosen"
    write_all(
        lambda k: write_grasps(k, chosen, 0, 0, generator_file, first), [0, 1, 7], 1, lambda _: None
    )
    # no choice of an untrained evaluator holds, so two that did are written into the files
    for path in chosen.iterdir():
        with np.load(path) as file:
            arrays = {k: file[k] for k in file}
        assert not arrays["held"].any()
        arrays |= {"T_object_palm": np.tile(np.eye(4), (4, 1, 1)), "joints": np.zeros((4, 15))}
        arrays |= {"held": np.array([1, 1, 0, 0], bool), "overlapping": np.zeros(4, bool)}
        np.savez(path, **arrays)
    short = tmp_path / "short"
    write_all(
        lambda k: write_grasps(k, short, 0, 0, generator_file, first, chosen),
        [0, 1, 7],
        1,
        lambda _: None,
    )
    data = read_grasps(next(iter(sorted(short.iterdir()))))
    assert len(data.held) == 2 * 2 + 2  # two tries short of each choice that held
    # of palms at I, along the hand's fingers
    back = (HAND.T_hand_palm @ data.T_object_palm @ invert(HAND.T_hand_palm))[:, 2, 3]
    assert (back < -SHORT_M[0] + 4 * SHORT_SD).all()
    assert (back > -SHORT_M[1] - 4 * SHORT_SD).all()
    assert back.min() < -0.02
    for path in short.iterdir():  # nor do these hold
        with np.load(path) as file:
            arrays = {k: file[k] for k in file}
        np.savez(path, **(arrays | {"held": np.array([1, 0, 0, 0, 0, 0], bool)}))
    objects = load_objects(grasps, SMALL, 6, 0, chosen=chosen, short=short)
    assert [len(o.rows["short_held"]) for o in objects] == [1, 1, 0, 0, 0, 0, 1]
    assert [len(o.rows["short_failed"]) for o in objects] == [5, 5, 0, 0, 0, 0, 5]
    assert [len(o.rows["chosen_held"]) for o in objects] == [2, 2, 0, 0, 0, 0, 2]
    assert len(objects[6].rows["held"]) == 0
    assert len(objects[0].rows["held"]) == read_grasps(grasps / f"{objects[0].name}.npz").held.sum()
    labels = {"chosen_held": 1, "chosen_failed": 0, "short_held": 1, "short_failed": 0}
    for kind, label in labels.items():
        assert (batch_of(objects, 20, {kind: 1.0}, np.random.default_rng(0))[2] == label).all()
    network = load_ffhnet_evaluator(first)
    before = {k: v.clone() for k, v in network.state_dict().items()}
    ffhnet.tune(
        network,
        [objects[0], objects[1], objects[6]],
        SMALL,
        tmp_path / "tuned.ckpt",
        lambda *_: None,
    )
    after = network.state_dict()
    of_cloud = slice(SMALL.width, SMALL.width + SMALL.n_bps)
    assert torch.equal(after["rb2.fc1.weight"][:, of_cloud], before["rb2.fc1.weight"][:, of_cloud])
    for trained in (slice(0, SMALL.width), slice(SMALL.width + SMALL.n_bps, None)):
        assert not torch.equal(
            after["rb2.fc1.weight"][:, trained], before["rb2.fc1.weight"][:, trained]
        )


@pytest.mark.slow
def test_a_hand_in_the_far_side_of_an_object_does_not_hold_it(grasps: Path) -> None:
    """Catches labels from physics alone, which pushes such a hand out and may lift the object."""
    lifted = 0
    for index in range(6):
        object_model = procedural_object(index, 0)
        data = read_grasps(grasps / f"{object_model.name}.npz")
        world = FlyingHand(object_model)
        for T, joints in zip(
            data.T_object_palm[data.overlapping], data.joints[data.overlapping], strict=True
        ):
            world.put_palm(T, joints)
            if world.penetration(anything=True) > MAX_PENETRATION:
                lifted += world.lifts(joints, shake=True)
                assert not holds(world, T, joints)
    assert lifted > 0


def test_scores_against_closed_forms() -> None:
    """Catches an AUC of the wrong sign or with miscounted ties, and a wrong Brier score."""
    held = np.array([False, False, True, True])
    assert scores_of(np.array([0.1, 0.2, 0.8, 0.9]), held)["auc"] == 1.0
    assert scores_of(np.array([0.9, 0.2, 0.8, 0.1]), held)["auc"] == pytest.approx(0.25)
    assert scores_of(np.full(4, 0.5), held) == {"auc": 0.5, "brier": 0.25, "ece": 0.0, "held": 0.5}


def test_palms_keep_their_place() -> None:
    """Catches a translation that is permuted, scaled or lost."""
    T = np.eye(4)
    T[:3, 3] = (0.1, 0.2, 0.3)
    palms = palms_of(T[None], np.zeros((1, 15)))
    np.testing.assert_allclose(palms.translation, [[0.1, 0.2, 0.3]], atol=1e-7)


@pytest.mark.slow
def test_jaw_scenes_train_an_evaluator(tmp_path: Path) -> None:
    """Catches labels that are all alike, views that miss the object, and draws that vary."""
    settings = vfas.Settings(steps=2, batch=4, held_out=1)
    metrics = vfas.train_all(tmp_path, 3, settings, 2, 1, lambda *_: None)
    assert metrics["poses"] == {"training": 4 * 24, "held_out": 2 * 24}
    scenes = vfas.load_scenes(tmp_path / "scenes", 3, 0)
    held = np.concatenate([s.held for of_object in scenes for s in of_object])
    assert 0 < held.mean() < 1
    for of_object in scenes:
        for scene in of_object:
            # there are visible points near the seed
            assert 0.05 < np.linalg.norm(scene.points, axis=1).min() + 0.05 < 0.12
            assert scene.table.any()
    assert load_evaluator(tmp_path / "vfas_evaluator.safetensors").sizes == VFAS
    again = write_scenes(0, tmp_path / "again", 0, 2)
    assert (
        np.load(again)["held"].tolist()
        == np.load(tmp_path / "scenes" / again.name)["held"].tolist()
    )
