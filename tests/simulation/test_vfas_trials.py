"""VFAS-Grasp's trials.

Catches: arrangements that overlap, a disc that doesn't carry, a gripper whose twin or description
is another one, a seed that replay doesn't read, replay that plans otherwise than the loop did, a
wrong outcome.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from dgeval.cli import app
from dgeval.config import load_config
from dgeval.recording.contract import GRASP_TOPIC
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.robots.hand import hand_of
from dgeval.robots.loading import load_description
from dgeval.robots.parallel_jaw import HAND as JAW
from dgeval.robots.parallel_jaw import OPEN, TRAVEL, finger_targets
from dgeval.robots.urdf import robot_urdf
from dgeval.simulation.campaign import Campaign, prove_trial
from dgeval.simulation.scenario import load_scenario
from dgeval.simulation.setting import Setting, Turn
from dgeval.simulation.vfas_plan import plan_vfas, waiting_pose
from dgeval.simulation.vfas_trial import NEAR_HOME
from dgeval.simulation.world import World, matrix_of, twin_path
from dgeval.worlds.objects import eight_objects
from dgeval.worlds.scene import TURNTABLE_CENTRE, TURNTABLE_TOP, pose_of
from typer.testing import CliRunner

OBJECTS = eight_objects()


def test_published_sizes() -> None:
    """YCB's cracker box, chips can, can and bowl in mm. Catches a size in another unit."""
    sizes = {
        n: sorted(OBJECTS[n].extent() * 1000) for n in ("cracker_box", "chips_can", "can", "bowl")
    }
    assert sizes["cracker_box"] == pytest.approx([60, 158, 210])
    assert sizes["chips_can"] == pytest.approx([75, 75, 250])
    assert sizes["can"] == pytest.approx([66, 66, 101])
    assert sizes["bowl"] == pytest.approx([55, 159, 159], rel=0.05)


def test_arrangements_hold_each_object_as_often_and_stand_apart() -> None:
    """Ten arrangements of half of the objects; each is the target three times in each: 15 times in
    all.

    This is Table I of the paper. Catches arrangements that overlap or leave out an object.
    """
    scenario = load_scenario("table-clearing")
    plans = [plan_vfas(scenario, OBJECTS, 0, k) for k in range(scenario.trials)]
    assert Counter(p.object for p in plans) == dict.fromkeys(OBJECTS, 15)
    for p in plans:
        assert len(p.others) == 3
        assert p.object not in {o[0] for o in p.others}
        placed = [(p.object, p.x, p.y), *(o[:3] for o in p.others)]
        for i, (a, ax, ay) in enumerate(placed):
            for b, bx, by in placed[:i]:
                reach = (
                    np.linalg.norm(OBJECTS[a].extent()[:2])
                    + np.linalg.norm(OBJECTS[b].extent()[:2])
                ) / 2
                assert np.hypot(ax - bx, ay - by) > reach
    assert plans[0].others == plans[40].others


def test_turntable_and_handover_plans_are_the_papers() -> None:
    """Catches plans that leave the paper's objects, radii, angles or counts."""
    scenario = load_scenario("turntable")
    plans = [plan_vfas(scenario, OBJECTS, 0, k) for k in range(scenario.trials)]
    counts = Counter((p.object, round(np.hypot(p.x - TURNTABLE_CENTRE[0], p.y), 3)) for p in plans)
    assert counts == {(o, r): 5 for o in scenario.objects or () for r in (0.06, 0.10, 0.14)}
    assert {p.turn.speed > 0 for p in plans if p.turn} == {True, False}
    assert all(np.radians(60) <= p.turn.angle <= np.radians(120) for p in plans if p.turn)
    scenario = load_scenario("vfas-handover")
    plans = [plan_vfas(scenario, OBJECTS, 0, k) for k in range(scenario.trials)]
    assert Counter(p.object for p in plans) == dict.fromkeys(
        ("bowl", "bottle", "small_box", "mustard"), 24
    )
    ahead = waiting_pose()[:3, 3] + 0.15 * waiting_pose()[:3, 2]
    for p in plans:
        assert p.presenter is not None
        top = p.presenter.end + np.array([0, 0, OBJECTS[p.object].extent()[2] / 2 - 0.02])
        assert np.abs(top - ahead).max() <= 0.03 + 1e-9


def test_disc_carries_the_object_through_its_angle() -> None:
    """The path without a robot is a circle: the radius, rate and angle of the disc, and then rest.

    Catches a disc that doesn't carry.
    """
    setting = Setting(turn=Turn(0.2, -2 * np.pi / 10, np.radians(90)))
    x, y = TURNTABLE_CENTRE[0] + 0.10, TURNTABLE_CENTRE[1]
    path = twin_path(OBJECTS["can"], 0.0, x, y, 0.0, 3.5, setting)
    off = path[:, :2] - TURNTABLE_CENTRE
    assert np.hypot(*off.T) == pytest.approx(0.10, abs=0.003)
    turned = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    assert np.degrees(turned[-1]) == pytest.approx(-90, abs=2)
    assert abs(turned[19]) < 0.002
    middle = (turned[200] - turned[100]) / 1.0
    assert middle == pytest.approx(-2 * np.pi / 10, rel=0.02)
    assert path[-1, 2] == pytest.approx(OBJECTS["can"].rest_height() + TURNTABLE_TOP, abs=0.001)
    assert np.degrees(2 * np.arccos(abs(path[-1, 3]))) == pytest.approx(
        90, abs=2
    )  # it turns with the disc
    assert matrix_of(path[-1, :7])[2, 2] > 0.999


def test_description_and_physics_have_the_same_gripper() -> None:
    """Catches a finger on the wrong side, and a camera or grasp frame that differs from the
    physics.
    """
    description = load_description(robot_urdf(JAW.T_hand_camera, JAW), "jaw", (), 0.012)
    assert hand_of({j.name for j in description.joints.values()}) is JAW
    assert hand_of({"thumb_0"}) is None
    assert hand_of(FIVE_FINGERS.joints) is FIVE_FINGERS
    world = World(OBJECTS["can"], 0.0, gripper=JAW)
    world.start(NEAR_HOME, OPEN, 0.5, 0.0, 0.0, 0.0)
    T_left = np.linalg.inv(pose_of(world.data, "hand_base")) @ pose_of(world.data, "left_jaw")
    joint = next(j for j in description.joints.values() if j.name == "left_jaw")
    assert np.allclose(joint.at(TRAVEL), T_left, atol=1e-6)
    assert T_left[0, 3] == pytest.approx(TRAVEL)
    palm = description.joints["palm_link"]
    assert np.allclose(
        pose_of(world.data, "hand_base") @ palm.origin, world.T_base_palm(), atol=1e-6
    )


def test_jaws_close_at_their_speed() -> None:
    """Catches another closing speed, and jaws that do not press."""
    assert np.allclose(finger_targets(0.0, OPEN), TRAVEL)
    assert np.allclose(finger_targets(0.1, OPEN), TRAVEL - 0.015)
    assert (finger_targets(1.0, OPEN) < 0).all()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:  # type: ignore[type-arg]
    """One trial of `table-clearing` in closed loop, as a recording, and its truth."""
    out = tmp_path_factory.mktemp("vfas")
    for folder in ("truth", "recorded"):
        (out / folder).mkdir()
    proved = prove_trial(Campaign(load_scenario("table-clearing"), 0, 2, out), 1)
    return out / f"{proved['id']}.mcap", proved["verdict"]


@pytest.mark.slow
def test_replay_plans_from_the_recording_what_the_loop_did(
    recorded: tuple[Path, dict], tmp_path: Path
) -> None:  # type: ignore[type-arg]
    """Catches a seed that replay doesn't read, another plan than the loop's, and
    another outcome.
    """
    path, truth = recorded
    args = [
        "replay",
        str(path),
        "--pipeline",
        "vfas",
        "--out",
        str(tmp_path / "run"),
        "--no-review",
        "--json",
        "--set",
        'checks.accept=["measured"]',  # its target, too near from the start, has no box here
    ]
    result = CliRunner().invoke(app, args)
    assert result.exit_code == 0, result.output
    row = pd.read_parquet(tmp_path / "run" / "trials.parquet").iloc[0]
    assert row["pipeline"] == "vfas"
    assert row["outcome"] == truth["outcome"]
    assert "DIS in place of GMFlow" in row["notes"]
    assert "sampler" not in row["notes"]  # the seed was recorded
    frames = pd.read_parquet(tmp_path / "run" / "frames" / f"{row['trial']}.parquet")
    before = frames[frames["t_ns"] < row["t_close_ns"]]
    # The same stages on the same images: the loop's grasp at each frame is replay's, as far as
    # joint noise and clocks allow.
    believed = _believed(path)
    apart = [
        np.linalg.norm(
            r[["grasp_px", "grasp_py", "grasp_pz"]].to_numpy(float) - believed[r["t_ns"]]
        )
        for _, r in before.iterrows()
        if r["t_ns"] in believed and not np.isnan(r["grasp_px"])
    ]
    assert len(apart) > 10
    assert np.median(apart) < 0.02
    assert before["grasp_score"].max() > 0.5
    assert before["region_factor"].min() == 1.0
    for run in ("a", "b"):
        short = [
            *args[:4],
            "--frames",
            "0:8",
            "--out",
            str(tmp_path / run),
            "--no-review",
            "--json",
        ]
        assert CliRunner().invoke(app, short).exit_code == 0
    a, b = (
        pd.read_parquet(tmp_path / run / "trials.parquet").filter(like="digest_")
        for run in ("a", "b")
    )
    assert a.equals(b)


def _believed(path: Path) -> dict[int, np.ndarray]:
    """Position of the loop's grasp by time ns."""
    trial = open_trial(find_trials([path])[0], load_config("vfas"))
    return {p.t_ns: p.pose[:3] for p in trial.scan.poses[GRASP_TOPIC]}


def test_unknown_scenario_parts_are_refused(tmp_path: Path) -> None:
    """Catches a VFAS scenario without a table, turntable or presenter that is simulated all the
    same.
    """
    (tmp_path / "s.toml").write_text('name = "s"\n[pipeline]\npipeline = "vfas"\n')
    result = CliRunner().invoke(
        app, ["simulate", str(tmp_path / "s.toml"), "--out", str(tmp_path / "o"), "--no-images"]
    )
    assert result.exit_code == 2
    assert "turntable" in result.output


def test_committed_manifests_are_the_plans(tmp_path: Path) -> None:
    """Catches a scenario that draws other trials than its manifest names.

    The platform's line may differ.
    """
    import make_manifests

    make_manifests.main(tmp_path)
    for made in sorted(tmp_path.iterdir()):
        kept = Path(make_manifests.__file__).with_name(made.name)
        assert [r for r in made.read_text().splitlines() if not r.startswith("platform")] == [
            r for r in kept.read_text().splitlines() if not r.startswith("platform")
        ]
    assert len(list(tmp_path.iterdir())) == 4
