"""One object through the simulator and through replay's control: the same choice and twist."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from dgeval.geometry import invert, transform
from dgeval.perception.types import Model
from dgeval.planning.carried import Belief
from dgeval.planning.control import Controller, HandState
from dgeval.planning.model_grasps import FFHNetProposals, ModelGrasps
from dgeval.planning.recorded_arm import RecordedArm
from dgeval.recording.messages import JointSample
from dgeval.recording.robot import JointTrack, RobotStates
from dgeval.recording.transforms import TransformTree
from dgeval.robots.diana7 import JOINT_NAMES
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.simulation.campaign import Campaign, grasps_of, plan_of, world_of
from dgeval.simulation.faults import Faults
from dgeval.simulation.perception import ModelledPerception, PerceivedObject
from dgeval.simulation.scenario import load_scenario
from dgeval.simulation.trial import limited, run_trial
from dgeval.simulation.world import World
from dgeval.worlds.closing import CONTROL_S


@dataclass
class Kept:
    """A perceiver that keeps what it gave, by frame."""

    perceiver: ModelledPerception
    given: dict[int, PerceivedObject] = field(default_factory=dict)

    def perceive(self, frame: int, t_ns: int, world: World) -> PerceivedObject:
        self.given[frame] = self.perceiver.perceive(frame, t_ns, world)
        return self.given[frame]


@pytest.mark.slow
def test_simulator_and_replay_choose_and_command_the_same() -> None:
    """Catches a grasp that one of the two carries on, draws or chooses otherwise. What the robot
    believed frame by frame, and where its hand was, is given to replay's controller.
    """
    scenario = load_scenario("conveyor").model_copy(update={"faults": {}, "max_seconds": 0.7})
    campaign = Campaign(scenario, 0, 1, Path("unused"))
    plan = replace(plan_of(campaign, 105), index=0, faults=Faults())  # a mug at 0.2 m/s
    world = world_of(campaign, plan)
    kept = Kept(ModelledPerception(scenario, plan, world))
    run = run_trial(plan, scenario, world, grasps_of(campaign, plan), kept)
    hand = world.gripper
    text = robot_urdf(hand.T_hand_camera, hand)
    set_points = [
        JointSample(
            round(k * CONTROL_S * 1e9),
            dict(zip(JOINT_NAMES, tick.snapshot.q_set.tolist(), strict=True)),
        )
        for k, tick in enumerate(run.ticks)
    ]
    robot = RobotStates(
        TransformTree(), "camera", "base_link", hand.palm_frame or "palm_link",
        load_description(text, "the arm", (), 0.01), (), JointTrack.of(set_points, 0), (),
    )  # fmt: skip
    config = scenario.pipeline.model_copy(update={"seed": plan.seed})
    reaches = RecordedArm(robot, config.sync.max_pose_gap_s).reaches
    grasps = ModelGrasps(FFHNetProposals(config), reaches, config)
    controller = Controller(grasps, hand, config)
    frames = {frame.tick: frame for frame in run.frames}
    model: Model | None = None
    compared = 0
    for k, tick in enumerate(run.ticks):
        world.restore(tick.snapshot)
        t_ns = round(k * CONTROL_S * 1e9)
        T_base_camera = world.T_base_hand() @ hand.T_hand_camera
        frame = frames.get(k)
        if frame is not None and frame.T_base_object is not None and frame.velocity is not None:
            cloud = kept.given[frame.index].cloud
            if cloud is not None:
                points = transform(invert(frame.T_base_object), cloud)
                model = Model(points, np.zeros_like(points))
            believed = Belief(t_ns, frame.T_base_object, frame.velocity, frame.accepted)
            controller.see(t_ns, frame.index, believed, model, T_base_camera)
        [control] = controller.run([HandState(t_ns, world.T_base_palm(), T_base_camera)])
        if tick.T_base_grasp is None:
            continue
        assert control.grasps is not None
        assert control.command is not None
        choice = control.grasps.choice
        assert choice is not None
        np.testing.assert_allclose(choice.T_base_palm, tick.T_base_grasp, atol=1e-12)
        # the simulated robot knows its palm 2 ms late, and looks at the object's origin where
        # replay looks at the middle of the model
        twist = limited(control.command.twist)
        np.testing.assert_allclose(twist[:3], tick.twist[:3], atol=0.003)
        np.testing.assert_allclose(twist[3:], tick.twist[3:], atol=0.1)
        assert choice.hand_score == pytest.approx(tick.score, abs=0.01)
        assert control.execute == tick.execute
        compared += 1
    assert compared > 50
