"""The names that recordings and dgeval agree on: topics, events, and the keys of an event.

`dgeval simulate` writes these topics and every reader knows them by these names. A robot's own log
may have any of them. No other file of the package spells one out.
"""

from __future__ import annotations

from typing import Final, Literal, get_args

DGEVAL_PREFIX: Final = "/dgeval/"
"""Topics of dgeval's own contract; none of them is a camera or a robot state."""

BELIEF_PREFIX: Final = "/dgeval/belief/"
"""What the robot believed while it ran; read to say which part of it is to blame."""

TRUTH_PREFIX: Final = "/truth/"
"""What a simulator knows for certain. Never an input of a verdict, never a label."""

ROBOT_DESCRIPTION: Final = "/robot_description"
"""Latched topic with the robot's URDF or MJCF, std_msgs/String; in any namespace."""

OWN_PREFIXES: Final = ("/dgeval/", "/truth/")
"""Topics that begin so are dgeval's own; no other robot has them."""

EVENTS_TOPIC: Final = "/dgeval/events"
"""std_msgs/String: one JSON object {"event": kind, ...} per message."""

SEED_TOPIC: Final = "/dgeval/seed"
"""PoseStamped, T_base_seed: another planner's proposed grasp, which VFAS-Grasp starts from."""

TARGET_TOPIC: Final = "/dgeval/belief/target_pose"
"""PoseStamped, T_camera_model: where the robot tracked its target."""

VELOCITY_TOPIC: Final = "/dgeval/belief/velocity"
"""TwistStamped, base frame, m/s: the target's velocity by the robot's filter."""

GRASP_TOPIC: Final = "/dgeval/belief/grasp"
"""PoseStamped, T_base_palm: the grasp that the robot chose."""

CANDIDATES_TOPIC: Final = "/dgeval/belief/candidates"
"""PoseArray, T_base_palm at its stamp, an image's time: grasps that the robot could choose from."""

CANDIDATE_SCORES_TOPIC: Final = "/dgeval/belief/candidate_scores"
"""Float64MultiArray: predicted success of each of the newest candidates, in their order."""

GRASP_JOINTS_TOPIC: Final = "/dgeval/belief/grasp_joints"
"""JointState, rad or m: the preshape of the chosen grasp."""

GRASP_SCORE_TOPIC: Final = "/dgeval/belief/grasp_score"
"""Float64: predicted success of the chosen grasp, which equations 3 to 5 weigh."""

SCORE_TOPIC: Final = "/dgeval/belief/score"
"""Float64: the grasp score of the hand as it is."""

EXECUTE_TOPIC: Final = "/dgeval/belief/execute"
"""Bool: whether the robot decided to execute the grasp."""

ACCEPTED_TOPIC: Final = "/dgeval/belief/accepted"
"""Bool, after each frame: whether the robot merged it into its model."""

MASK_TOPIC: Final = "/dgeval/belief/mask"
"""CompressedImage, PNG: the robot's mask of its target, only with frames in which it saw it."""

MODEL_TOPIC: Final = "/dgeval/belief/model"
"""PointCloud2, model frame, m: the robot's model of its target."""

COMMAND_TOPIC: Final = "/dgeval/belief/twist_command"
"""TwistStamped, base frame, m/s and rad/s: the commanded twist of the palm."""

TRUTH_OBJECT_TOPIC: Final = "/truth/object_pose"
"""PoseStamped, T_base_object."""

TRUTH_UNDISTURBED_TOPIC: Final = "/truth/undisturbed_pose"
"""PoseStamped, T_base_object where the object would be had the hand not touched it."""

TRUTH_CONTACTS_TOPIC: Final = "/truth/contacts"
"""std_msgs/String, JSON: contacts of the hand, and force by finger, N."""

TRUTH_VERDICT_TOPIC: Final = "/truth/verdict"
"""std_msgs/String, JSON: outcome, class of failure, sub-cause and blame."""

DEPTH_UNIT: Final = "/option/Depth_Units/value"
"""End of a topic's name, Float32 or text: m per unit of depth, as librealsense's recorder says."""

IMAGE_METADATA: Final = "/image/metadata"
"""End of a topic's name, text `key=value;…`: librealsense's facts of the image logged at that time.
From SDK 2.58 on the image's own stamp is when it arrived, and its time stands here, in ms."""

EventKind = Literal["trial_start", "close", "lift", "trial_end", "label"]
"""What an entry of EVENTS_TOPIC may say. Other kinds are kept and shown, and mean nothing."""

EVENT_KINDS: Final = frozenset(get_args(EventKind))
"""The kinds as a set; a message may hold the kind alone, without JSON."""

TRIAL_START_EVENT: Final = "trial_start"
"""A trial begins; a recording with several is cut there. May carry NOTES_KEY."""

CLOSE_EVENT: Final = "close"
"""The hand was commanded to close."""

LIFT_EVENT: Final = "lift"
"""The hand was commanded to lift."""

TRIAL_END_EVENT: Final = "trial_end"
"""A trial ends; what follows belongs to no trial."""

LABEL_EVENT: Final = "label"
"""An operator says how the trial ended, under LABEL_KEY."""

EVENT_KEY: Final = "event"
"""Key of an event's kind."""

TIME_KEY: Final = "t_ns"
"""Key of an event's own time, ns; without it the log time counts."""

NOTES_KEY: Final = "notes"
"""Key of a list of sentences about how the recording was made."""

LABEL_KEY: Final = "label"
"""Key of an operator's label: true, false, or one of SUCCESS_LABELS or FAILURE_LABELS, any case."""

LABEL_KEYS: Final = (LABEL_KEY, "outcome", "result", "success")
"""Keys under which a label is looked for, in this order; dgeval writes the first."""

SUCCESS_LABELS: Final = ("success", "succeeded", "successful", "pass", "passed", "ok")
"""Words of an operator for a success."""

FAILURE_LABELS: Final = ("failure", "fail", "failed", "unsuccessful")
"""Words of an operator for a failure."""

GIVE_A_LABEL: Final = "--label success or --label failure"
"""How an operator's word is given, in messages; without a pipe, which a shell would run."""


def label_of(text: object) -> Literal["success", "failure"] | None:
    """What an operator's label says; None for a word that is neither."""
    if isinstance(text, bool):
        return "success" if text else "failure"
    word = str(text).strip().lower()
    if word in SUCCESS_LABELS:
        return "success"
    return "failure" if word in FAILURE_LABELS else None
