"""A trial's notes on its replay: what ran in place of the papers' parts, and what was left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgeval.config import PIPELINES, Config
from dgeval.paper_values import CHOICE, CONTROL, PERCEPTION, departure_note
from dgeval.perception.trackers import tracker_named
from dgeval.recording.contract import SEED_TOPIC
from dgeval.recording.trials import Trial
from dgeval.replay.causal import Step, grasp_source, seed_of
from dgeval.robots.hand import Hand

FEW_FRAMES = 0.1  # share of the frames without the hand's shape, above which a note says it; ours


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Numbers of frames of a trial.

    lost: the tracker had lost the target. predicted: no accepted registration. no_depth: the
    target was tracked, but without usable depth on it. no_hand: the hand's shape was not known.
    no_grasp: there were candidates, and none was chosen. not_started: nothing was found to follow.
    holes: sum over the frames of the share of the picture without depth.
    """

    frames: int = 0
    lost: int = 0
    predicted: int = 0
    no_depth: int = 0
    no_hand: int = 0
    no_grasp: int = 0
    no_seed: int = 0
    not_started: int = 0
    holes: float = 0.0

    def with_frame(self, step: Step) -> FrameCounts:
        """The counts after one more frame."""
        state = step.tracked.state
        grasps = None if step.control is None else step.control.grasps
        unobserved = state == "tracked" and step.perceived.observation is None
        return replace(
            self,
            frames=self.frames + 1,
            lost=self.lost + (state == "lost"),
            predicted=self.predicted + (not step.accepted),
            no_depth=self.no_depth + unobserved,
            no_hand=self.no_hand + (step.frame.hand is None),
            no_seed=self.no_seed + (step.vfas is None),
            no_grasp=self.no_grasp + (grasps is not None and grasps.choice is None),
            not_started=self.not_started + (state == "not_started"),
            holes=self.holes
            + 1.0
            - float(np.count_nonzero(step.frame.depth)) / step.frame.depth.size,
        )


def self_filter_of(trial: Trial, counts: FrameCounts) -> str:
    """What took the robot's own hand out of the images: geometry, mask or none."""
    if trial.robot.hand_links and counts.no_hand < max(counts.frames, 1):
        return "geometry"
    return "mask" if trial.static_mask is not None else "none"


def recording_notes(trial: Trial, counts: FrameCounts) -> list[str]:
    """What the recording lacks, and what was read in its place; counts: after the last frame."""
    notes = list(trial.notes)
    if counts.no_depth:
        notes.append(
            f"no usable depth on the target in {counts.no_depth} of {counts.frames} frames: "
            "followed in colour"
        )
    unmatched = trial.n_unmatched_colour
    if unmatched or trial.n_unmatched_depth:
        notes.append(f"unmatched images: {unmatched} colour, {trial.n_unmatched_depth} depth")
    if trial.n_undecodable_frames:
        notes.append(f"{trial.n_undecodable_frames} frames could not be decoded")
    if self_filter_of(trial, counts) == "none":
        known = trial.robot.description is not None
        why = "the hand's links are not known (frames.palm)" if known else "no robot description"
        if trial.robot.hand_links:
            why = "the hand's joint states are not recorded"
        notes.append(f"self_filter: none, {why}")
    elif trial.robot.hand_links and counts.no_hand > FEW_FRAMES * counts.frames:
        notes.append(
            f"the hand's shape is not known in {counts.no_hand} of {counts.frames} frames, for "
            "want of joint states or poses: there it was not taken out of the images"
        )
    return notes


def pipeline_notes(trial: Trial, config: Config, counts: FrameCounts) -> list[str]:
    """What ran in place of the papers' parts, and with which parameters; counts: after the last
    frame.
    """
    notes = []
    if config.pipeline == "dynamic" and trial.spec.scenario == "handover":
        notes.append("pipeline dynamic, as configured, though the manifest says handover")
    if config.pipeline == "handover" and trial.spec.scenario == "handover":
        own = ", ".join(
            f"{section}.{key} = {getattr(getattr(config, section), key)}"
            for section, values in PIPELINES["handover"].items()
            for key in values
        )
        notes.append(f"pipeline handover: {own}")
    notes.append(tracker_note(config))
    if config.pipeline == "vfas":
        notes += departure_note(config, ("vfas",))
        notes += vfas_notes(config, seed_of(trial) is not None, trial.robot.hand)
        return notes + contact_notes(trial, config, counts)
    source = grasp_source(trial.robot, trial.choices, config.grasps)
    chosen = CHOICE if source in ("ffhnet", "candidates") else ()
    notes += departure_note(config, (*PERCEPTION, *chosen, *CONTROL))
    if source == "recorded":
        notes.append("stand-in: the recorded grasp in place of FFHNet; hand_score as recorded")
    elif source in ("ffhnet", "candidates"):
        from dgeval.planning.recorded_arm import recorded_arm

        if isinstance(arm := recorded_arm(trial.robot), str):
            notes.append(f"no grasp was refused for the arm's reach, which is not known: {arm}")
        if source == "ffhnet":
            notes += ffhnet_notes(config)
        else:
            notes.append(
                "stand-in: the recorded candidates in place of FFHNet's; hand_score as recorded"
            )
        if counts.no_grasp:
            from dgeval.planning.grasps import MOST_TRIED  # imports torch

            notes.append(
                f"no grasp was chosen in {counts.no_grasp} of {counts.frames} frames: no candidate "
                f"is free of the model, or none of the first {MOST_TRIED} that are is in reach"
            )
    return notes


def contact_notes(trial: Trial, config: Config, counts: FrameCounts) -> list[str]:
    """What became of Contact-GraspNet's seed, where it is asked for one."""
    c = config.vfas
    if c.contact_graspnet is None or c.search or seed_of(trial) is not None:
        return []
    from dgeval.planning.recorded_arm import recorded_arm

    notes = []
    if isinstance(arm := recorded_arm(trial.robot), str):
        notes.append(f"the seeds are ranked by the evaluator, not by the arm's limits: {arm}")
    if counts.no_seed == counts.frames:
        notes.append(
            "no seed: the target was not seen, or Contact-GraspNet has no confident grasp on it "
            f"that the jaws and the arm can do; a seed of your own: topic {SEED_TOPIC}"
        )
    return notes


def tracker_note(config: Config) -> str:
    """What follows the target in the image: the paper's tracker, or what stands in for it."""
    stand_in = tracker_named(config.tracking.method).STAND_IN
    if stand_in is not None:
        return f"stand-in: {stand_in} in place of TransT-M"
    if config.tracking.weights is None:  # a tracker of a third party
        return f"tracking by {config.tracking.method}"
    from dgeval.networks.checkpoints import name_of_weights  # imports torch
    from dgeval.networks.transt import TransTM
    from dgeval.perception.trackers.transt import transt_of

    name = name_of_weights(Path(config.tracking.weights))
    network = transt_of(config.tracking.weights)
    if isinstance(network, TransTM) and network.has_mask:
        return f"tracking by TransT-M, {name}"
    lacks = "the mask" if isinstance(network, TransTM) else "the mask and new templates"
    return f"stand-in: {name}, which lack TransT-M's parts for {lacks}; depth steps give the mask"


def ffhnet_notes(config: Config) -> list[str]:
    """The weights of FFHNet, and their threshold."""
    from dgeval.networks.checkpoints import name_of_weights
    from dgeval.planning.grasps import networks_of  # imports torch

    given = [Path(f) for f in (config.grasps.generator, config.grasps.evaluator) if f is not None]
    names = [name_of_weights(path) for path in given]
    weights = ", ".join(names if len(names) == 2 else [*names, "dgeval's own weights"])
    own, given_c_e = networks_of(config.grasps).c_e, config.execution.c_e
    closes = f"closing above a score of {own:g}, the threshold of these weights"
    if given_c_e is not None and given_c_e != own:
        closes = f"closing above a score of {given_c_e:g}, though these weights' own is {own:g}"
    return [f"grasps by FFHNet with {weights}, {closes}"]


def vfas_notes(config: Config, seeded: bool, hand: Hand | None) -> list[str]:
    """What ran in place of VFAS-Grasp's own parts. hand: of the log."""
    from dgeval.networks.checkpoints import name_of_weights
    from dgeval.planning.vfas.gripper import ALIKE_M, apart, gripper_of, trained_gripper

    weights = config.vfas.evaluator
    quality = "dgeval's own weights" if weights is None else f"weights {Path(weights).name}"
    trained, gripper = trained_gripper(), gripper_of(hand)
    off = 0.0 if isinstance(gripper, str) else apart(gripper, trained)
    links = "; sliding fingers stand for its gripper's links" if off <= ALIKE_M else ""
    notes = [f"VFAS-Grasp's evaluator with {quality}{links}"]
    if isinstance(gripper, str):
        notes.append(
            f"VFAS-Grasp's evaluator is shown the gripper of its training, {trained.opening:.2f} m "
            f"wide: {gripper}"
        )
    elif off > ALIKE_M:
        notes.append(
            f"VFAS-Grasp's evaluator is shown the log's gripper, {gripper.opening:.3f} m wide "
            f"({gripper.told}); it was trained with one of {trained.opening:.3f} m, whose links "
            f"lie {off * 1000:.0f} mm beside on average: how well it scores this one is not known"
        )
    if config.vfas.motion_field and config.vfas.flow == "gmflow":
        assert config.vfas.flow_weights is not None  # the configuration refuses it
        notes.append(f"optical flow by GMFlow, {name_of_weights(Path(config.vfas.flow_weights))}")
    elif config.vfas.motion_field:
        notes.append("stand-in: DIS in place of GMFlow")
    if not seeded and not config.vfas.search:
        seeds = config.vfas.contact_graspnet
        notes.append(
            "stand-in: a sampler scored by the evaluator in place of Contact-GraspNet's seed"
            if seeds is None
            else f"seed by Contact-GraspNet, weights {Path(seeds).name}"
        )
    return notes
