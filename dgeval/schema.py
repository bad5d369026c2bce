"""Every column of the result tables: type, unit, meaning, the stage that makes it.

Source of Arrow schemas and digests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from dgeval.determinism import ColumnDigest

SCHEMA_VERSION = 1
NOTES_APART = " | "  # between two notes of a trial; a note may hold "; "
Kind = Literal["int", "float", "bool", "str"]


@dataclass(frozen=True, slots=True)
class Column:
    name: str
    kind: Kind
    unit: str
    meaning: str
    stage: str


def _vector(prefix: str, axes: str, unit: str, meaning: str, stage: str) -> list[Column]:
    return [Column(f"{prefix}_{axis}", "float", unit, meaning, stage) for axis in axes.split()]


def _pose(prefix: str, meaning: str, stage: str) -> list[Column]:
    return [
        *_vector(prefix, "px py pz", "m", meaning, stage),
        *_vector(prefix, "qx qy qz qw", "", meaning, stage),
    ]


FRAMES: tuple[Column, ...] = (
    Column("frame", "int", "", "index in the trial", "input"),
    Column("t_ns", "int", "ns", "header stamp of the colour image", "input"),
    Column(
        "tracking", "str", "", "the image tracker's word: tracked, lost, not_started", "tracking"
    ),
    *_vector("box", "x0 y0 x1 y1", "px", "box of the target in colour", "tracking"),
    Column("mask_area", "int", "px", "pixels of the target with usable depth", "tracking"),
    Column("n_observed", "int", "points", "P_t after crop and filters", "registration"),
    Column("n_filtered", "int", "points", "P''_t, kept by equation 1", "fusion"),
    Column("n_model", "int", "points", "Q_t", "fusion"),
    Column(
        "icp_accepted",
        "bool",
        "",
        "the registration passed the gate; null where there was none",
        "registration",
    ),
    Column(
        "icp_fitness",
        "float",
        "",
        "share of P_t with a model point within the search radius",
        "registration",
    ),
    Column(
        "icp_gate_fitness",
        "float",
        "",
        "the same within max(5 mm, 2 sigma(z)) along the normal",
        "registration",
    ),
    Column("icp_rmse", "float", "m", "over the matches within the search radius", "registration"),
    Column("icp_reject_reason", "str", "", "why there is no accepted registration", "registration"),
    *_pose(
        "model",
        "T_camera_model; model frame = colour optical frame of the first accepted frame",
        "registration",
    ),
    *_vector("centroid", "px py pz", "m", "model centroid in the camera frame", "fusion"),
    *_vector("feature", "px py pz", "m", "feature point, base frame", "estimation"),
    *_vector("velocity", "x y z", "m/s", "estimated velocity, base frame", "estimation"),
    Column(
        "velocity_sd",
        "float",
        "m/s",
        "square root of the largest eigenvalue of its covariance",
        "estimation",
    ),
    Column("predicted", "bool", "", "no accepted registration in this frame", "registration"),
    *_pose(
        "grasp", "chosen grasp g*_t as T_base_palm; vfas: the seed after the iteration", "grasps"
    ),
    Column(
        "grasp_score",
        "float",
        "",
        "predicted success of the chosen grasp; vfas: score S of equation 1",
        "grasps",
    ),
    Column(
        "grasp_metric",
        "float",
        "",
        "dynamic grasp metric of the chosen grasp, equations 3 to 5",
        "grasps",
    ),
    Column("n_grasps", "int", "", "candidates the grasp was chosen from", "grasps"),
    *_pose("hand", "recorded palm pose, T_base_palm", "input"),
    Column("hand_score", "float", "", "evaluator's score of the recorded palm pose", "execution"),
    Column(
        "error_linear",
        "float",
        "m",
        "hand to grasp; vfas: to the goal, which is the pre-grasp pose at first",
        "servo",
    ),
    Column("error_angular", "float", "rad", "hand to grasp, geodesic", "servo"),
    *_vector(
        "twist",
        "vx vy vz",
        "m/s",
        "equation 7 at the recorded state, base axes, palm origin",
        "servo",
    ),
    *_vector("twist", "wx wy wz", "rad/s", "equation 7 at the recorded state, base axes", "servo"),
    Column(
        "execute",
        "bool",
        "",
        "close now, in a control period since the frame before: score above c_e, or the robot's "
        "own decision; vfas: the pre-grasp pose has been held",
        "execution",
    ),
)
# Logged beside version 1; in no digest until the schema's version moves.
FRAMES_ADDED: tuple[Column, ...] = (
    Column(
        "nis",
        "float",
        "",
        "normalised innovation squared of the velocity update, 3 degrees of freedom",
        "estimation",
    ),
    Column(
        "residual_translation",
        "float",
        "m",
        "motion of the centred clouds, the other reading of A3",
        "registration",
    ),
    Column("n_features", "int", "", "image features followed on the target", "tracking"),
    Column(
        "track_confidence",
        "float",
        "",
        "that box and mask are the target's, 0 to 1; null where the tracker does not say",
        "tracking",
    ),
    Column(
        "occluded", "bool", "", "something in front hides at least half of the target", "tracking"
    ),
    Column("reacquired", "bool", "", "tracked again after it was lost", "tracking"),
    Column(
        "grasp_quality",
        "float",
        "",
        "vfas: mean quality of the best candidate over its noisy copies",
        "grasps",
    ),
    Column("grasp_spread", "float", "", "vfas: spread of its quality over them", "grasps"),
    Column("region_factor", "float", "", "vfas: scale of the sampling region", "grasps"),
    *_vector("motion", "x y z", "m/s", "vfas: motion field near the seed, base frame", "grasps"),
)
STAGES: tuple[str, ...] = (
    "input",
    "tracking",
    "registration",
    "fusion",
    "estimation",
    "grasps",
    "servo",
    "execution",
)

# stages that are held against the robot's own values, and what is compared
FIDELITY: dict[str, str] = {
    "target": "pose of the target",
    "velocity": "velocity of the target",
    "mask": "mask of the target",
    "grasp": "chosen grasp",
    "score": "score of the hand",
    "twist": "commanded twist",
    "decision": "time of the decision to close",
}
TRIALS: tuple[Column, ...] = (
    Column("trial", "str", "", "id, unique in the run", "trial"),
    Column("recording", "str", "", "file name of the recording", "trial"),
    Column("pipeline", "str", "", "dynamic, handover or vfas", "trial"),
    Column("base_frame", "str", "", "frame of base quantities", "trial"),
    Column("scenario", "str", "", "from the manifest", "trial"),
    Column("object", "str", "", "from the manifest", "trial"),
    Column("speed", "float", "m/s", "nominal, from the manifest", "trial"),
    Column("speed_measured", "float", "m/s", "from hindsight", "trial"),
    Column("t_start_ns", "int", "ns", "first moment of the trial", "trial"),
    Column("t_end_ns", "int", "ns", "last moment of the trial", "trial"),
    Column("n_frames", "int", "", "paired frames", "trial"),
    Column("n_lost", "int", "", "frames in which the tracker had lost the target", "trial"),
    Column("n_predicted", "int", "", "frames without an accepted registration", "trial"),
    Column("self_filter", "str", "", "geometry, mask or none", "trial"),
    Column("target_source", "str", "", "bbox, recorded (marked in the log) or automatic", "trial"),
    Column("t_execute_ns", "int", "ns",
           "first control period in which the replay would have closed", "trial"),
    Column("c_e", "float", "",
           "score of the hand above which the replay closes; null where the robot's own decisions "
           "count, or nothing is scored", "trial"),
    Column("t_close_ns", "int", "ns", "close command, or what was taken for it", "trial"),
    Column("close_source", "str", "", "event, manifest, command, joints, width or effort", "trial"),
    Column("closing_source", "str", "",
           "of the verdict's hand's closing: known (its own), recorded, estimates, set or "
           "limits", "trial"),
    Column("estimates", "str", "", "SHA-256 of the file given with --estimates", "trial"),
    Column("t_fingers_ns", "int", "ns", "when the fingers are seen to begin to close", "trial"),
    Column("t_decisive_ns", "int", "ns",
           "when it was decided: the push, the close, or a good moment that went by", "trial"),
    Column("contact_link", "str", "", "the link that pushed or first met the object", "trial"),
    Column("outcome", "str", "", "success, failure, no_grasp, incomplete, unknown", "trial"),
    Column("outcome_source", "str", "", "label or inferred", "trial"),
    Column("failure_class", "str", "",
           "imprecise_pose, collision, timing, unknown; null unless failure", "trial"),
    Column("p_imprecise_pose", "float", "", "probability", "trial"),
    Column("p_collision", "float", "", "probability", "trial"),
    Column("p_timing", "float", "", "probability", "trial"),
    Column("p_unknown", "float", "", "probability", "trial"),
    Column("observed_class", "str", "",
           "what a person at the video would write, as the papers' tables count: as failure_class",
           "trial"),
    Column("p_observed_imprecise_pose", "float", "", "probability", "trial"),
    Column("p_observed_collision", "float", "", "probability", "trial"),
    Column("p_observed_timing", "float", "", "probability", "trial"),
    Column("p_observed_unknown", "float", "", "probability", "trial"),
    Column("cause_given", "str", "", "failure_class by an operator's word in a manifest", "trial"),
    Column("sub_cause", "str", "", "which link and when, how late, missed or slipped", "trial"),
    Column("blame", "str", "", "the term whose removal alone restores tolerance", "trial"),
    Column("p_blame", "float", "", "probability", "trial"),
    Column("belief_source", "str", "", "recorded, replayed_faithful, replayed", "trial"),
    *(Column(f"fidelity_{stage}", "str", "",
             f"the replay's {what} beside the robot's own in the last second: faithful, not "
             "faithful, not known; null where the robot recorded none", "trial")
      for stage, what in FIDELITY.items()),
    Column("gap_s", "float", "s", "blind gap before the close", "trial"),
    Column("gap_sided", "str", "", "none, one, two", "trial"),
    Column("execute_in_window", "bool", "",
           "the replay would have closed when a close holds the object, by the twin, or as the "
           "recorded one did; null where that moment was not tried", "trial"),
    Column("hindsight_score_at_execute", "float", "",
           "of the grasp chosen when the replay would have closed: FFHNet's evaluator on the final "
           "model where the whole log has the object; null of grasps that FFHNet didn't propose",
           "trial"),
    Column("evidence", "str", "", "what a person can check, with times", "trial"),
    Column("notes", "str", "",
           "on the recording, the target and the verdict, then every stand-in that ran in place of "
           "the papers' method; \" | \" stands between two", "trial"),
    *(Column(f"digest_{stage}", "str", "",
             f"SHA-256 over the frame columns of stage {stage}", "trial") for stage in STAGES),
)  # fmt: skip
HINDSIGHT: tuple[Column, ...] = (
    Column("frame", "int", "", "index in the trial", "hindsight"),
    Column("t_ns", "int", "ns", "header stamp of the colour image", "hindsight"),
    *_pose(
        "object",
        "T_base_model: where the whole log has the object; model frame as in frames",
        "hindsight",
    ),
    Column(
        "by",
        "str",
        "",
        "path (undisturbed), registration, depth, colour, hand or support (moves with it)",
        "hindsight",
    ),
    Column("sd", "float", "m", "of the position; on the path only", "hindsight"),
    Column(
        "hand_distance",
        "float",
        "m",
        "signed distance of the hand's nearest link to the object",
        "hindsight",
    ),
    Column("hand_link", "str", "", "that link", "hindsight"),
)
TIMINGS: tuple[Column, ...] = (
    Column("trial", "str", "", "id", "timing"),
    Column("frame", "int", "", "index in the trial", "timing"),
    Column(
        "stage", "str", "", "read (container and decoding), tracking, registration, …", "timing"
    ),
    Column("seconds", "float", "s", "wall time", "timing"),
)


def check_keys(row: Mapping[str, Any], columns: Sequence[Column], table: str) -> None:
    """Refuse a row with a key that is none of the columns: KeyError, which names the key.

    table: name of the table, for the message. A missing key is allowed: it is a null.
    """
    unknown = row.keys() - {c.name for c in columns}
    if unknown:
        names = ", ".join(sorted(unknown))
        raise KeyError(f"no such column of {table}: {names}")


class StageDigests:
    """SHA-256 per stage over its version-1 frame columns, fed row by row."""

    def __init__(self) -> None:
        self._stages = {
            stage: ColumnDigest({c.name: c.kind for c in FRAMES if c.stage == stage})
            for stage in STAGES
        }

    def add(self, row: Mapping[str, Any]) -> None:
        """Add one row of the frame table; KeyError for a key that is no column of it."""
        check_keys(row, (*FRAMES, *FRAMES_ADDED), "frames")
        for digest in self._stages.values():
            digest.add(row)

    def hexdigests(self) -> dict[str, str]:
        return {stage: digest.hexdigest() for stage, digest in self._stages.items()}


def notes_of(told: str | None) -> list[str]:
    """The notes of a trial, one string each, from the column `notes`."""
    return told.split(NOTES_APART) if told else []


def arrow_schema(columns: Sequence[Column]) -> Any:
    """A pyarrow schema; unit and meaning as field metadata, the schema version in its own."""
    import pyarrow as pa

    types = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "str": pa.string()}
    fields = [
        pa.field(c.name, types[c.kind], metadata={"unit": c.unit, "meaning": c.meaning})
        for c in columns
    ]
    return pa.schema(fields, metadata={"dgeval_schema_version": str(SCHEMA_VERSION)})


def arrow_table(columns: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> Any:
    """A pyarrow table of the rows; a missing key is a null, an unknown one a KeyError."""
    import pyarrow as pa

    for row in rows:
        check_keys(row, columns, "the table")
    return pa.Table.from_pylist(
        [{c.name: row.get(c.name) for c in columns} for row in rows], schema=arrow_schema(columns)
    )
