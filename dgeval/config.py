"""Every parameter with its default, unit and source.

The command line takes precedence over the file, the file over the default. The environment is never
read. An unknown key is an error that names the nearest known key.
"""

from __future__ import annotations

import difflib
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from dgeval.errors import Place, UsageError

Model = TypeVar("Model", bound=BaseModel)
TRACKERS = "dgeval.perception.trackers"  # a layer above: imported where a method is given
Pose7 = tuple[float, float, float, float, float, float, float]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RolesConfig(Section):
    """Topic of each role; None: found by type and name."""

    colour: str | None = None
    depth: str | None = None
    intrinsics: str | None = None
    camera_pose: str | None = Field(
        None, description="a PoseStamped or Odometry topic instead of tf"
    )
    hand_pose: str | None = Field(None, description="a PoseStamped topic instead of tf or joints")
    hand_joints: str | None = None
    events: str | None = None
    target: str | None = Field(
        None,
        description="topic of masks, vision_msgs detections or poses that mark the target, or its "
        "frame on /tf",
    )


class RoleClock(Section):
    offset_ns: int = Field(0, description="added to every stamp of the role")


class ClockConfig(Section):
    colour: RoleClock = RoleClock()
    depth: RoleClock = RoleClock()
    camera_pose: RoleClock = RoleClock()
    hand_pose: RoleClock = RoleClock()
    hand_joints: RoleClock = RoleClock()
    topics: dict[str, int] = Field(
        {}, description="ns by topic of joint states or poses, added to every stamp of it"
    )


class FramesConfig(Section):
    """Names of tf frames; None: found in the recording."""

    base: str | None = None
    camera: str | None = Field(
        None, description="colour optical frame; default: frame_id of the colour images"
    )
    palm: str | None = None
    namespace: str | None = Field(
        None, description="of the robot's topics, where several robots use the same names"
    )


class CalibrationConfig(Section):
    description: str | None = Field(
        None, description="URDF or MJCF file; default: a /robot_description in the log"
    )
    mesh_dirs: tuple[str, ...] = ()
    flange: str | None = Field(None, description="link that T_flange_camera refers to")
    T_flange_camera: Pose7 | None = Field(
        None, description="hand-eye calibration, px py pz qx qy qz qw"
    )
    T_colour_depth: Pose7 | None = Field(
        None, description="where the depth camera is in the colour camera, px py pz qx qy qz qw"
    )
    depth_scale: float | None = Field(
        None,
        gt=0,
        description="m per unit of depth; default: as the file says, else 0.001 of integers, 1 of "
        "floats",
    )
    depth_offset_m: float = Field(0.0, description="m that are added to depth")
    intrinsics: tuple[float, float, float, float] | None = Field(
        None, description="fx fy cx cy where none is recorded"
    )
    static_mask: str | None = Field(
        None, description="image; depth is dropped where it is not black"
    )


class HandConfig(Section):
    """What the description of a hand that dgeval doesn't know leaves open (docs/hands.md)."""

    root: str | None = Field(
        None, description="link that the fingers hang on; default: found from the palm's frame"
    )
    closed: dict[str, float] = Field(
        {}, description="rad or m by joint, of the closed hand; default: the joints' limits"
    )
    close_s: float | None = Field(
        None, gt=0, le=3.0, description="s in which it closes where the trial shows no close"
    )
    centre: tuple[float, float, float] | None = Field(
        None,
        description="m, palm's frame: where held objects are; default: where the fingertips meet",
    )
    approach: tuple[float, float, float] | None = Field(
        None,
        description="direction, palm's frame, in which it comes to an object; default: from the "
        "palm to the centre, across the way that two fingertips close",
    )

    @field_validator("approach")
    @classmethod
    def _is_a_direction(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and not any(value):
            raise ValueError("three zeros are no direction")
        return value


class SyncConfig(Section):
    tolerance_s: float | None = Field(
        None, gt=0, description="colour-depth; default: half the colour period"
    )
    jump_s: float = Field(5.0, gt=0, description="a forward jump of the stamps to count")
    max_pose_gap_s: float = Field(0.5, gt=0, description="poses farther apart are not interpolated")
    max_unmatched_share: float = Field(
        0.5, ge=0, le=1, description="of the rarer pictures without a partner, before exit code 3"
    )


class SelfFilterConfig(Section):
    margin: float = Field(0.010, ge=0, description="m; depth this close to a hand link is dropped")
    radius_default: float = Field(
        0.012, gt=0, description="m; capsule radius where a link has no shape that can be read"
    )


class PlaneConfig(Section):
    enabled: bool = True
    hypotheses: int = Field(32, ge=1)
    min_support: float = Field(
        0.35, gt=0, le=1, description="share of the surroundings that must lie in the plane"
    )
    tolerance_sigmas: float = Field(
        3.0, gt=0, description="half thickness in depth standard deviations"
    )


def _weights_for(
    is_chosen: bool, weights: str | None, key: str, value: str, weights_key: str
) -> None:
    """Refuse a network without its weights, and weights that nothing would read."""
    if is_chosen and weights is None:
        text = (
            f'{key} = "{value}" needs {weights_key}, a file of the authors (none is shipped): '
            f"--set {weights_key}=FILE"
        )
        raise PydanticCustomError("weights", text)
    if weights is not None and not is_chosen:
        text = f'{weights_key} is read with {key} = "{value}" only'
        raise PydanticCustomError("weights", text)


class TrackingConfig(Section):
    method: str = "model"
    weights: str | None = Field(
        None, description="of `transt`: the authors' transtm_vot.pth, transtm.pth or transt.pth"
    )
    window_weight: float | None = Field(
        None,
        ge=0,
        le=1,
        description="of `transt`: how much a target near its last place is preferred; default: "
        "0.574 with TransT-M's weights (VOT), 0.49 with TransT's",
    )
    update_iou: float = Field(
        0.869,
        description="of `transt`: predicted overlap above which the second template is made anew "
        "(TransT-M, VOT)",
    )
    mask_above: float = Field(
        0.60, ge=0, le=1, description="of `transt`: probability of the target's pixels (VOT)"
    )
    lost_below: float = Field(
        0.3,
        ge=0,
        le=1,
        description="of `transt`: the box's score below which the target is lost (ours: the paper "
        "has no rule; not measured)",
    )
    corners: int = Field(200, ge=8, description="image features followed on the target")
    keyframe_angle: float = Field(
        0.20, gt=0, description="rad; a new keyframe when the view has turned by this much"
    )
    keyframe_scale: float = Field(
        1.25, gt=1, description="a new keyframe when the target's size has changed this much"
    )
    iterations: int = Field(8, ge=1)
    align_points: int = Field(500, ge=50, description="model points used in the alignment to depth")
    min_visible: float = Field(
        0.35, gt=0, le=1, description="share of the target's box inside the image, else lost"
    )
    min_agree: float = Field(
        0.5, gt=0, le=1, description="share of model points with agreeing depth, else lost"
    )
    min_corners: int = Field(
        6, ge=3, description="followed features, else the image alone does not carry the track"
    )
    reacquire_s: float = Field(
        2.0, ge=0, description="how long after a loss the target is looked for where it should be"
    )

    @field_validator("method")
    @classmethod
    def _is_a_tracker(cls, method: str) -> str:
        """Refuse a name that no tracker has before a recording is opened."""
        try:
            import_module(TRACKERS).tracker_named(method)
        except UsageError as error:
            text = "no such tracker, {hint}"
            raise PydanticCustomError("tracker", text, {"hint": error.hint}) from error
        return method

    @model_validator(mode="after")
    def _tracker_has_weights(self) -> TrackingConfig:
        _weights_for(
            self.method == "transt", self.weights, "tracking.method", "transt", "tracking.weights"
        )
        return self


class ObservationConfig(Section):
    c_z: float = Field(
        0.1, gt=0, description="m; allowed distance from the median depth (Table V, c_z)"
    )
    max_points: int = Field(1000, ge=50)
    min_points: int = Field(60, ge=10, description="fewer points are no observation")


class RegistrationConfig(Section):
    method: Literal["small_gicp", "open3d", "kiss_icp"] = "small_gicp"
    search_radius: float = Field(
        0.02, gt=0, description="m (docs/papers.md, 'ICP direction and fitness')"
    )
    max_iterations: int = Field(15, ge=1)
    colour: bool = Field(
        True, description="refine with the tracker's image features (beyond the paper)"
    )
    accept: Literal["gate", "recorded"] = Field(
        "gate", description="what says whether a frame is merged: the gate, or the robot's own word"
    )
    c_a_f: float = Field(0.8, gt=0, lt=1, description="least gate fitness, strict (Table V, c_a,f)")
    c_a_v: float = Field(4.0, gt=0, description="m/s (Table V, c_a,v)")
    c_a_w: float = Field(4.0, gt=0, description="rad/s (Table V, c_a,omega)")
    gate_distance: float = Field(
        0.005, gt=0, description="m; the gate counts matches within max(this, 2 sigma)"
    )


class FusionConfig(Section):
    n_s: int = Field(5, ge=1, description="previous accepted observations (Table V, n_s)")
    epsilon: float = Field(0.01, gt=0, description="m (Table V, epsilon)")
    max_model_points: int = Field(
        4096,
        ge=100,
        description="N_max; a random subset is kept beyond it (docs/papers.md, 'Random subset')",
    )


class EstimationConfig(Section):
    sigma_acceleration: float = Field(
        0.3, gt=0, description="m/s^2 (0.3 belt, 1.0 handover; docs/papers.md, 'Velocity filter')"
    )
    sigma_position: float = Field(0.004, gt=0, description="m (docs/papers.md, 'Velocity filter')")
    loss_policy: Literal["constant_velocity", "zero"] = "constant_velocity"
    null_after_s: float = Field(
        1.0, gt=0, description="without an accepted frame, feature and velocity become null"
    )


class GraspsConfig(Section):
    source: Literal["auto", "recorded", "candidates", "ffhnet", "none"] = Field(
        "auto",
        description="auto: the grasp that the robot chose where it is recorded, else a choice "
        "among its recorded candidates, else FFHNet where the hand is one it knows",
    )
    candidates: int = Field(
        256,
        ge=1,
        le=10_000,
        description="grasps drawn per frame (paper: not given, "
        "docs/papers.md, 'Number and order of grasps')",
    )
    max_overlap: float = Field(
        0.004,
        ge=0,
        description="m; candidates whose hand lies deeper in the model are left out, the one "
        "chosen last if 2.5 times as deep (ours; 1 turns it off)",
    )
    support_z: float | None = Field(
        None,
        description="m in the base frame; candidates whose hand reaches deeper below it are left "
        "out (ours)",
    )
    way_m: float = Field(
        0.0,
        ge=0,
        description="m before a grasp over which the hand's straight way to it must be free of the "
        "model too (ours)",
    )
    generator: str | None = Field(
        None, description="weights, .safetensors or the authors' *_gen_net.pt; default: shipped"
    )
    evaluator: str | None = Field(
        None, description="weights, .safetensors or the authors' *_eva_net.pt; default: shipped"
    )


class SelectionConfig(Section):
    c_m_s: float = Field(1.0, description="Table V, c_m,s")
    c_m_t: float = Field(
        -0.1,
        description="per m (Table V, c_m,t; distance always costs, "
        "docs/papers.md, 'Signs of equation 5')",
    )
    c_m_r: float = Field(-0.2, description="per rad (Table V, c_m,r)")
    keep_margin: float = Field(
        0.0,
        ge=0,
        description="by how much another grasp's metric must be better than that of the one chosen "
        "last (ours)",
    )
    literal_eq5: bool = Field(
        False, description="the signs of equation 5 as printed, which reward distance"
    )
    rotation_vector_difference: bool = Field(
        False,
        description="|r_G - r_R| instead of the geodesic angle "
        "(docs/papers.md, 'Rotation distance')",
    )


class ServoConfig(Section):
    c_p_v: float = 1.0
    c_d_v: float = 2.0
    c_p_w: float = 2.5
    c_d_w: float = 5.0
    c_O: float = Field(0.2, gt=0, description="m (Table V)")
    c_G: float = Field(0.05, gt=0, description="m (Table V)")
    beyond_m: float = Field(
        0.0,
        ge=0,
        description="m beyond the grasp along the fingers that the hand is sent to as long as it "
        "is before it (ours)",
    )

    @model_validator(mode="after")
    def _far_before_near(self) -> ServoConfig:
        """Equation 6 blends between c_G, near, and c_O, far."""
        if self.c_O <= self.c_G:
            raise PydanticCustomError("order", "c_O must be larger than c_G")
        return self


class OneEuroConfig(Section):
    """Parameters of the 1 euro filter at 20 Hz (docs/papers.md, "Low pass")."""

    position_cutoff: float = Field(1.5, gt=0, description="Hz, least")
    position_beta: float = Field(5.0, ge=0, description="Hz per m/s")
    rotation_cutoff: float = Field(1.5, gt=0, description="Hz, least")
    rotation_beta: float = Field(0.5, ge=0, description="Hz per rad/s")
    d_cutoff: float = Field(1.0, gt=0, description="Hz, of the speeds")


class VfasConfig(Section):
    """VFAS-Grasp. Where the description says "ours", the paper gives no figure (docs/papers.md,
    "Open constants", "Tolerance of the pre-grasp")."""

    evaluator: str | None = Field(
        None,
        description="weights, .safetensors or 6-DoF GraspNet's latest_net.pth; default: shipped",
    )
    labels: Literal["vfas", "jsll"] | None = Field(
        None,
        description="of scene and gripper points, 0/1 or 1/0; default: as the weights were trained "
        "(docs/papers.md, 'Labels')",
    )
    centre: Literal["grasp", "mean"] | None = Field(
        None, description="what points are relative to; default: as the weights'"
    )
    contact_graspnet: str | None = Field(
        None,
        description="seeds where none is recorded: a checkpoint of cgn-pytorch, or `installed`; "
        "default: dgeval's sampler",
    )
    flow: Literal["dis", "gmflow"] = Field(
        "dis",
        description="optical flow of the motion field (paper: GMFlow, whose weights you give)",
    )
    flow_weights: str | None = Field(
        None, description="of GMFlow: the authors' gmflow_*.pth, basic or with refinement"
    )
    candidates: int = Field(64, ge=1, le=4096, description="N, grasps drawn per iteration (ours)")
    half_width: float = Field(0.02, gt=0, description="m on each axis of the seed (paper)")
    half_angle: float = Field(5.0, ge=0, description="degrees of pitch and yaw (paper)")
    noise_candidates: Literal["all", "top8"] = Field(
        "top8", description="which get noisy copies; paper: all"
    )
    copies: int = Field(5, ge=1, le=100, description="k, noisy copies (ours)")
    noise: float = Field(0.002, ge=0, description="m, each axis (paper)")
    k1: float = Field(2.0, ge=0, description="per m of distance from the seed (ours)")
    k2: float = Field(0.5, ge=0, description="per rad of rotation from the seed (ours)")
    k3: float = Field(0.5, ge=0, description="of the spread of quality (ours)")
    good_score: float = Field(0.5, description="a grasp is good above it (paper)")
    keep_seed: bool = Field(
        True,
        description="the seed itself is a candidate too (ours: else no iteration can leave it in "
        "place)",
    )
    adaptive: bool = Field(True, description="the region and N grow until a good grasp is found")
    factor: float = Field(1.3, ge=1, description="lambda, growth per iteration (paper)")
    most_factor: float = Field(3.0, ge=1, description="paper")
    motion_field: bool = Field(True, description="the seed moves with what moves near it")
    rho: float = Field(
        0.05, gt=0, description="m, sphere round the seed of the motion field (ours)"
    )
    low_pass: bool = Field(True, description="the 1 euro filter on the seed")
    filter: OneEuroConfig = OneEuroConfig()
    period_s: float = Field(0.05, gt=0, description="between iterations (paper: 20 Hz)")
    pregrasp: float = Field(0.10, gt=0, description="m before the grasp, along its approach (ours)")
    hold_distance: float = Field(0.005, gt=0, description="m (ours)")
    hold_angle: float = Field(3.0, gt=0, description="degrees (ours)")
    hold_iterations: int = Field(5, ge=1, description="within both before the advance (paper)")
    hold_needs_score: bool = Field(
        False,
        description="only iterations with a good grasp count (ours; paper: within both, once a "
        "grasp has been found)",
    )
    search: bool = Field(
        False,
        description="the seed is ahead of the gripper and stays until a good grasp is found "
        "(handover)",
    )
    search_ahead: float = Field(0.15, gt=0, description="m (paper)")
    refine: bool = Field(
        True, description="without, the seed is executed as it is: the baseline of Table I"
    )
    gain: float = Field(2.0, gt=0, description="1/s of the proportional controller (ours)")

    @model_validator(mode="after")
    def _flow_has_weights(self) -> VfasConfig:
        _weights_for(
            self.flow == "gmflow", self.flow_weights, "vfas.flow", "gmflow", "vfas.flow_weights"
        )
        return self


class ExecutionConfig(Section):
    c_e: float | None = Field(
        None,
        description="execution threshold, strict; default: that of the weights, 0.4 of the shipped "
        "ones, 0.7 of others and of recorded scores (Table V)",
    )
    decision: Literal["auto", "recorded", "score"] = Field(
        "auto",
        description="what says when to close: the robot's own decision, or the score above c_e; "
        "auto: the robot's own beside its own grasps, where it is recorded and no c_e is given",
    )
    arrived_m: float | None = Field(
        None,
        gt=0,
        description="m of the hand to the grasp within which alone it is executed (ours; paper: by "
        "score alone)",
    )
    arrived_deg: float = Field(6.0, gt=0, description="degrees, with arrived_m (ours)")


class ScheduleConfig(Section):
    """Latency of a stage, s: from the stamp of an image to the time its result is usable."""

    perception_latency_s: float = Field(0.0, ge=0)
    grasps_latency_s: float = Field(0.0, ge=0)
    control_period_s: float = Field(
        0.008,
        gt=0,
        description="least time between two control periods; they are at the recorded states of "
        "the hand (ours)",
    )


class VerdictConfig(Section):
    method: Literal["twin", "geometry"] = Field(
        "twin", description="what tells whether another close would have worked"
    )
    draws: int = Field(
        3, ge=1, le=50, description="of the object's place, friction and mass, in the twin"
    )
    least: float = Field(
        0.6,
        ge=0,
        le=1,
        description="probability of the best class under which the answer is unknown",
    )


class FidelityConfig(Section):
    seeds: int = Field(
        0,
        ge=0,
        le=8,
        description="further replays with other seeds, where the robot recorded what it believed: "
        "a difference from it that two seeds show too is none",
    )


class ReviewConfig(Section):
    jpeg_quality: int = Field(
        85, ge=1, le=100, description="only for colour that was not recorded as JPEG or PNG"
    )
    depth_every: int = Field(3, ge=1, description="a depth image in every n-th frame")
    cloud_points: int = Field(1000, ge=1)


class ChecksConfig(Section):
    accept: tuple[str, ...] = Field(
        (), description="names of failed checks that stay notes and set no exit code"
    )


# values that belong to an experiment: in the handover a lost target stands still (paper IV-B), and
# people change their speed faster than a belt (docs/papers.md, "Velocity filter")
PIPELINES: dict[str, dict[str, dict[str, Any]]] = {
    "dynamic": {},
    "handover": {"estimation": {"loss_policy": "zero", "sigma_acceleration": 1.0}},
    "vfas": {},
}


# what is given as a file that a trial's result depends on
FILES = (
    "calibration.description",
    "calibration.static_mask",
    "tracking.weights",
    "grasps.generator",
    "grasps.evaluator",
    "vfas.evaluator",
    "vfas.flow_weights",
    "vfas.contact_graspnet",
)


class Config(Section):
    pipeline: Literal["dynamic", "handover", "vfas"] = "dynamic"
    seed: int = Field(0, ge=0)
    roles: RolesConfig = RolesConfig()
    clock: ClockConfig = ClockConfig()
    frames: FramesConfig = FramesConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    hand: HandConfig = HandConfig()
    sync: SyncConfig = SyncConfig()
    self_filter: SelfFilterConfig = SelfFilterConfig()
    plane: PlaneConfig = PlaneConfig()
    tracking: TrackingConfig = TrackingConfig()
    observation: ObservationConfig = ObservationConfig()
    registration: RegistrationConfig = RegistrationConfig()
    fusion: FusionConfig = FusionConfig()
    estimation: EstimationConfig = EstimationConfig()
    grasps: GraspsConfig = GraspsConfig()
    selection: SelectionConfig = SelectionConfig()
    servo: ServoConfig = ServoConfig()
    vfas: VfasConfig = VfasConfig()
    execution: ExecutionConfig = ExecutionConfig()
    schedule: ScheduleConfig = ScheduleConfig()
    fidelity: FidelityConfig = FidelityConfig()
    verdict: VerdictConfig = VerdictConfig()
    review: ReviewConfig = ReviewConfig()
    checks: ChecksConfig = ChecksConfig()

    def files(self) -> dict[str, Path]:
        """The files that are given, by their key."""
        given = {key: getattr(getattr(self, key.split(".")[0]), key.split(".")[1]) for key in FILES}
        return {key: Path(value) for key, value in given.items() if value is not None}

    def of_pipeline(self, name: str) -> Config:
        """The same with a pipeline's own values, where a person has not set others."""
        changed: dict[str, Any] = {"pipeline": name}
        for section, values in PIPELINES[name].items():
            part: Section = getattr(self, section)
            given = part.model_fields_set
            own = {key: value for key, value in values.items() if key not in given}
            changed[section] = part.model_copy(update=own)
            # what a pipeline says is no person's word: another pipeline may say otherwise
            changed[section].model_fields_set.intersection_update(given)
        return self.model_copy(update=changed)

    def of_scenario(self, scenario: str | None) -> Config:
        """The same for a trial of a manifest's scenario: a handover has values of its own."""
        is_given = "pipeline" in self.model_fields_set
        if self.pipeline == "dynamic" and not is_given and scenario == "handover":
            return self.of_pipeline("handover")
        return self


def load_config(pipeline: str = "dynamic", assignments: tuple[str, ...] = ()) -> Config:
    """The configuration of a pipeline's name or TOML file, changed by `section.key=value` texts.

    UsageError names the faulty key or assignment.
    """
    values: dict[str, Any] = {}
    if pipeline.endswith(".toml"):
        values = read_toml(Path(pipeline))
    elif pipeline not in PIPELINES:
        raise UsageError(
            f"no pipeline {pipeline!r}",
            hint=f"built in: {', '.join(PIPELINES)}; or give a FILE.toml",
        )
    elif pipeline != "dynamic":  # what nobody has set a manifest's scenario may choose
        values["pipeline"] = pipeline
    for assignment in assignments:
        _assign(values, assignment)
    try:
        config = Config.model_validate(values)
        return config.of_pipeline(config.pipeline) if PIPELINES[config.pipeline] else config
    except ValidationError as error:
        raise UsageError("; ".join(_explain(e) for e in error.errors())) from error


def validated(model: type[Model], values: dict[str, Any], what: str, path: Path) -> Model:
    """A file's values as a model; UsageError names the file and the first faulty key."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first: Any = error.errors()[0]
        key = ".".join(str(p) for p in first["loc"])
        hint = None
        if first["type"] == "extra_forbidden":
            first["msg"] = "there is no such key"
            hint = _known_keys(model, first["loc"])
        raise UsageError(f"{what}: {key}: {first['msg']}", Place(str(path)), hint) from error


def _known_keys(model: type[BaseModel], where: tuple[int | str, ...]) -> str | None:
    """What may stand in the place of an unknown key; None where that is not known."""
    at: Any = model
    for part in where[:-1]:
        if isinstance(part, int):
            continue
        fields: dict[str, Any] = getattr(at, "model_fields", {})
        at = fields[part].annotation if part in fields else None
        at = next((a for a in get_args(at) if isinstance(a, type)), at)
    if not (isinstance(at, type) and issubclass(at, BaseModel)):
        return None
    return f"there are {', '.join(sorted(at.model_fields))}"


def read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"can't be read ({error.strerror})", Place(str(path))) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"not TOML ({error})", Place(str(path))) from error


def _assign(values: dict[str, Any], assignment: str) -> None:
    key, sign, text = assignment.partition("=")
    if not sign or not key:
        raise UsageError(f"--set {assignment!r} is not section.key=value")
    try:
        value = tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        value = text  # not a TOML value: taken as text
    *sections, last = key.strip().split(".")
    node = values
    for name in sections:
        node = node.setdefault(name, {})
        if not isinstance(node, dict):
            raise UsageError(f"--set {assignment!r}: {name} is not a section")
    node[last] = value


def _explain(error: Any) -> str:
    path = [str(p) for p in error["loc"]]
    key = ".".join(path)
    if error["type"] != "extra_forbidden":
        return f"{key}: {error['msg']} (got {error['input']!r})"
    model: type[BaseModel] = Config
    for name in path[:-1]:
        model = model.model_fields[name].annotation  # type: ignore[assignment]
    nearest = difflib.get_close_matches(path[-1], model.model_fields, n=1)
    hint = (
        f", did you mean {'.'.join([*path[:-1], nearest[0]])}?"
        if nearest
        else f"; known: {', '.join(model.model_fields)}"
    )
    return f"unknown key {key}{hint}"
