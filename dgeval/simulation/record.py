"""A finished trial as a recording, in the contract of real logs (docs/simulation.md, "Topics").

It also holds the robot's beliefs and the truth.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dgeval.determinism import generator
from dgeval.geometry import Array, invert, transform
from dgeval.paper_values import CHOICE, CONTROL, departure_note
from dgeval.planning.proposals import Proposals
from dgeval.recording.contract import (
    ACCEPTED_TOPIC,
    CANDIDATE_SCORES_TOPIC,
    CANDIDATES_TOPIC,
    CLOSE_EVENT,
    COMMAND_TOPIC,
    EVENT_KEY,
    EVENTS_TOPIC,
    EXECUTE_TOPIC,
    GRASP_JOINTS_TOPIC,
    GRASP_SCORE_TOPIC,
    GRASP_TOPIC,
    LIFT_EVENT,
    MASK_TOPIC,
    MODEL_TOPIC,
    NOTES_KEY,
    OWN_PREFIXES,
    ROBOT_DESCRIPTION,
    SCORE_TOPIC,
    SEED_TOPIC,
    TARGET_TOPIC,
    TRIAL_END_EVENT,
    TRIAL_START_EVENT,
    TRUTH_CONTACTS_TOPIC,
    TRUTH_OBJECT_TOPIC,
    TRUTH_UNDISTURBED_TOPIC,
    TRUTH_VERDICT_TOPIC,
    VELOCITY_TOPIC,
)
from dgeval.recording.write import (
    camera_info_message,
    cloud_message,
    compressed_depth_message,
    joint_state,
    jpeg_file_message,
    message,
    numbers,
    open_writer,
    png_message,
    pose_array,
    pose_stamped,
    text,
    twist_stamped,
)
from dgeval.robots.diana7 import JOINT_NAMES as ARM_JOINTS
from dgeval.robots.urdf import CAMERA_FRAME, robot_urdf
from dgeval.simulation.physics import AS_MODELLED
from dgeval.simulation.render import Renderer
from dgeval.simulation.scenario import Scenario
from dgeval.simulation.seeing import Images, encode
from dgeval.simulation.trial import FrameBelief, Run, Tick
from dgeval.simulation.truth import Truth
from dgeval.simulation.world import World, matrix_of
from dgeval.worlds.closing import CLOSE_S, CONTROL_S, SETTLE_S
from dgeval.worlds.hand_and_object import SUCCESS_RULE
from dgeval.worlds.objects import surface_points
from dgeval.worlds.scene import ENGINE

START_NS = 1_800_000_000_000_000_000  # ns, time stamp of every recording's first message; ours
BASE = "base_link"  # the base frame
JOINT_NOISE, SPEED_NOISE, EFFORT_NOISE = 1e-4, 2e-3, 0.02  # rad, rad/s, Nm; 1 sigma; ours
DEPTH_TOPIC = "/camera/aligned_depth_to_color/image_raw/compressedDepth"
COLOUR_TOPIC = "/camera/color/image_raw/compressed"
# Notes that a recording's start event carries.
MODELLED = (
    "simulated: tracking and registration in the loop are modelled (truth with drawn errors), "
    "not TransT-M and ICP"
)
RENDERED = (
    "simulated: the model tracker stands in for TransT-M in the loop; "
    "registration, fusion and estimation ran on images"
)
VFAS = [
    "simulated: VFAS-Grasp with dgeval's own evaluator; DIS stands in for GMFlow",
    "simulated: seeds are grasps known to hold, with a drawn error, "
    "in place of Contact-GraspNet's; fingers slide",
]
GRASPS = {
    "analytic": (
        "simulated: grasps from an analytic sampler checked in physics "
        "and an analytic score stand in for FFHNet"
    ),
    "ffhnet": "simulated: grasps and scores by FFHNet with dgeval's own weights",
}


@dataclass(frozen=True, slots=True)
class Recorded:
    """What was written: how many frames, and the box of the target in the first one.

    bbox: x0 y0 x1 y1 px; None if the target is not visible.
    """

    frames: int
    bbox: tuple[float, float, float, float] | None


def write_recording(
    path: Path,
    run: Run,
    verdict: dict[str, Any],
    twin: Array,
    scenario: Scenario,
    world: World,
    renderer: Renderer,
    kept: dict[int, Images],
    stranger: bool = False,
) -> Recorded:
    """Write everything in time order. `world` and `renderer` have the run's cameras.

    stranger: nothing is written that dgeval alone knows. kept: images drawn in the loop, by frame;
    the others are drawn now. verdict: what `verdict_document` gave. twin: the undisturbed path,
    rows per control period.
    """
    box: tuple[float, float, float, float] | None = None
    camera = renderer.cameras[0].intrinsics
    by_tick = {f.tick: f for f in run.frames}
    first: Array | None = None
    candidates: Proposals | None = None  # the last ones that were written
    with open_writer(path) as writer:

        def put(topic: str, t_ns: int, value: Any) -> None:
            if not (stranger and topic.startswith(OWN_PREFIXES)):
                writer.write(topic, t_ns, value)

        put(
            ROBOT_DESCRIPTION,
            START_NS,
            text(robot_urdf(world.gripper.T_hand_camera, world.gripper)),
        )
        if run.T_base_seed is not None:
            put(SEED_TOPIC, START_NS, pose_stamped(START_NS, BASE, run.T_base_seed))
        events = _events(run, scenario)
        for k, entries in _states(run, twin, world):
            t_ns = _at(k)
            for topic, value in [*events.pop(k, []), *entries]:
                put(topic, t_ns, value)
            belief = by_tick.get(k)
            if belief is None:
                continue
            if box is None and belief.index == run.frames[0].index:
                box = renderer.box()
            images = (
                kept[belief.index]
                if belief.index in kept
                else _draw(renderer, belief, scenario.camera.jpeg_quality)
            )
            put("/camera/color/camera_info", t_ns, camera_info_message(t_ns, CAMERA_FRAME, camera))
            put(COLOUR_TOPIC, t_ns, jpeg_file_message(t_ns, CAMERA_FRAME, images.jpeg))
            depth = compressed_depth_message(t_ns, CAMERA_FRAME, images.depth, scenario.depth_level)
            put(DEPTH_TOPIC, t_ns, depth)
            if images.mask is not None:
                put(
                    MASK_TOPIC,
                    t_ns,
                    png_message(t_ns, CAMERA_FRAME, images.mask.astype(np.uint8) * 255),
                )
            T_camera_model, cloud = images.T_camera_model, images.model
            if not kept and belief.T_base_object is not None:
                T_camera_object = (
                    invert(world.T_base_hand() @ world.gripper.T_hand_camera) @ belief.T_base_object
                )
                if first is None:
                    # the model frame is the camera of the first accepted frame, and moves with
                    # the object
                    first = T_camera_object
                    points = surface_points(
                        world.target, 500, generator(run.plan.seed, "model", run.plan.index)
                    )
                    cloud = transform(first, points)
                T_camera_model = T_camera_object @ invert(first)
            if T_camera_model is not None:
                put(
                    TARGET_TOPIC,
                    t_ns,
                    pose_stamped(t_ns, CAMERA_FRAME, T_camera_model),
                )
            accepted = message("std_msgs/Bool", data=belief.accepted)
            put(ACCEPTED_TOPIC, t_ns, accepted)
            if belief.proposals is not None and belief.proposals is not candidates:
                candidates = belief.proposals
                for topic, value in _candidates(belief, t_ns):
                    put(topic, t_ns, value)
            if cloud is not None:
                put(MODEL_TOPIC, t_ns, cloud_message(t_ns, CAMERA_FRAME, cloud))
            if belief.velocity is not None:
                twist = np.concatenate([belief.velocity, np.zeros(3)])
                put(VELOCITY_TOPIC, t_ns, twist_stamped(t_ns, BASE, twist))
        end = _at(len(run.ticks))
        put(TRUTH_VERDICT_TOPIC, end, text(json.dumps(verdict, sort_keys=True)))
        put(EVENTS_TOPIC, end, text(json.dumps({EVENT_KEY: TRIAL_END_EVENT})))
    return Recorded(len(run.frames), box)


def _draw(renderer: Renderer, belief: FrameBelief, quality: int) -> Images:
    colour, depth, mask = renderer.images(belief.index, mask=belief.accepted)
    return Images(encode(colour, quality), depth, mask)


def verdict_document(
    run: Run, truth: Truth, blame: dict[str, Any] | None, scenario: Scenario
) -> dict[str, Any]:
    """Everything known for certain about a trial, as one JSON object (`/truth/verdict`)."""
    plan = run.plan
    return {
        "outcome": truth.outcome,
        "success_rule": SUCCESS_RULE,
        "engine": ENGINE,
        "failure_class": truth.failure_class,
        "observed_class": truth.observed_class,
        "sub_cause": truth.sub_cause,
        "shift_s": truth.shift_s,
        "curve": truth.curve,
        "facts": None
        if truth.facts is None
        else {k: v for k, v in asdict(truth.facts).items() if k != "curve"},
        "seen": None if truth.seen is None else asdict(truth.seen),
        "pose_error_m": truth.pose_error_m,
        "foreign_contact": truth.foreign_contact,
        "t_first_contact_s": truth.t_first_contact,
        "near_threshold": truth.near,
        "t_close_s": None if run.close is None else round(run.close * CONTROL_S, 3),
        "faults": plan.faults.as_dict(),
        "faults_present": plan.faults.present(),
        **({} if plan.physics == AS_MODELLED else {"physics": asdict(plan.physics)}),
        "blame": blame,
        "scenario": scenario.plans_of or scenario.name,
        "object": plan.object,
        "speed": plan.nominal_speed,
        "yaw": plan.yaw,
        **({} if scenario.hand is None else {"hand": scenario.gripper.name}),
        "seed": plan.seed,
        "index": plan.index,
        **(
            {"grasps": "vfas" if scenario.vfas else scenario.grasps}
            if scenario.vfas or scenario.grasps != "analytic"
            else {}
        ),
    }


def _at(tick: int) -> int:
    return START_NS + round(tick * CONTROL_S * 1e9)


def _events(run: Run, scenario: Scenario) -> dict[int, list[tuple[str, Any]]]:
    perception = MODELLED if scenario.perception == "modelled" else RENDERED
    notes = [perception, GRASPS[scenario.grasps]]
    sections = (*CHOICE, *CONTROL) if scenario.grasps == "ffhnet" else ("selection", *CONTROL)
    notes += [f"simulated: {what}" for what in departure_note(scenario.pipeline, sections)]
    start = {EVENT_KEY: TRIAL_START_EVENT, NOTES_KEY: VFAS if scenario.vfas else notes}
    out = {0: [(EVENTS_TOPIC, text(json.dumps(start)))]}
    if run.close is not None:
        lift = run.close + round((CLOSE_S + SETTLE_S) / CONTROL_S)
        out[run.close] = [(EVENTS_TOPIC, text(json.dumps({EVENT_KEY: CLOSE_EVENT})))]
        out[lift] = [(EVENTS_TOPIC, text(json.dumps({EVENT_KEY: LIFT_EVENT})))]
    return out


def _states(run: Run, twin: Array, world: World) -> Iterator[tuple[int, list[tuple[str, Any]]]]:
    """Each control period with the world put into its state: joints, command, truth."""
    names = [*ARM_JOINTS, *world.gripper.joints]
    where = np.concatenate([world.arm, world.fingers])
    dofs = np.concatenate([world.arm_dof, world.finger_dof])
    touching = None
    for k, tick in enumerate(run.ticks):
        world.restore(tick.snapshot)
        t_ns = _at(k)
        noise = generator(run.plan.seed, f"joints/{run.plan.index}", k).normal(size=(3, len(names)))
        d = world.data
        position, velocity = (
            d.qpos[where] + JOINT_NOISE * noise[0],
            d.qvel[dofs] + SPEED_NOISE * noise[1],
        )
        effort = d.qfrc_actuator[dofs] + EFFORT_NOISE * noise[2]
        out = [("/joint_states", joint_state(t_ns, names, position, velocity, effort))]
        if run.close is None or k <= run.close:
            out.append((COMMAND_TOPIC, twist_stamped(t_ns, BASE, tick.twist)))
            out += _choice(tick, t_ns, world.gripper.drives)
        out.append((TRUTH_OBJECT_TOPIC, pose_stamped(t_ns, BASE, world.T_base_object())))
        if k % 10 == 0:
            out.append((TRUTH_UNDISTURBED_TOPIC, pose_stamped(t_ns, BASE, matrix_of(twin[k, :7]))))
        forces = world.finger_forces().round(3).tolist()
        now = {
            "hand_object": tick.contact,
            "hand_other": tick.foreign,
            "finger_force": dict(zip(world.gripper.fingers, forces, strict=True)),
        }
        if tick.contact or tick.foreign or touching is not False:
            out.append((TRUTH_CONTACTS_TOPIC, text(json.dumps(now))))
        touching = tick.contact or tick.foreign
        yield k, out


def _candidates(belief: FrameBelief, t_ns: int) -> list[tuple[str, Any]]:
    """The grasps of a frame that were not found touching or out of reach, and their scores."""
    proposals, T_base_object = belief.proposals, belief.T_base_object
    assert proposals is not None
    assert T_base_object is not None
    rows = proposals.eligible
    poses = T_base_object @ proposals.T_object_palm[rows]
    return [
        (CANDIDATES_TOPIC, pose_array(t_ns, BASE, poses)),
        (CANDIDATE_SCORES_TOPIC, numbers(proposals.scores[rows])),
    ]


def _choice(tick: Tick, t_ns: int, drives: tuple[str, ...]) -> list[tuple[str, Any]]:
    """The grasp chosen, its score, that of the hand, and the decision, of a control period."""
    out: list[tuple[str, Any]] = []
    if tick.T_base_grasp is not None and tick.preshape is not None:
        out.append((GRASP_TOPIC, pose_stamped(t_ns, BASE, tick.T_base_grasp)))
        out.append((GRASP_JOINTS_TOPIC, joint_state(t_ns, drives, tick.preshape)))
    if tick.grasp_score is not None:
        out.append((GRASP_SCORE_TOPIC, message("std_msgs/Float64", data=tick.grasp_score)))
    if tick.score is not None:
        out.append((SCORE_TOPIC, message("std_msgs/Float64", data=tick.score)))
    out.append((EXECUTE_TOPIC, message("std_msgs/Bool", data=tick.execute)))
    return out
