"""A small trial made of numbers alone: a box at constant velocity, a hand at constant twist,
nothing simulated.

Times are in seconds from the close command. All quantities are in the base frame unless a name says
otherwise. The object is an upright box on a level table. The model frame is turned and shifted
against the box, as a camera's would be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from dgeval.config import Config
from dgeval.geometry import Array, Intrinsics, invert, pose_from_matrix, transform
from dgeval.hindsight.second_pass import Hindsight
from dgeval.hindsight.smoothing import By, Sighting, smooth
from dgeval.perception.plane import Plane
from dgeval.recording.camera import Camera
from dgeval.recording.closes import CloseKnown
from dgeval.recording.containers.container import Opened, RawMessage, Topic
from dgeval.recording.events import Events
from dgeval.recording.frame_reader import FrameReader, LostFrames
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.messages import Event, JointSample, StampedPose
from dgeval.recording.pairing import Pair, Window
from dgeval.recording.robot import robot_states
from dgeval.recording.roles import Roles
from dgeval.recording.scan import ImageHead, Scan, TopicTimes
from dgeval.recording.trials import Trial
from dgeval.robots import dlr_hit_hand as hand
from dgeval.robots import urdf
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.robots.hand import KnownHand
from dgeval.robots.parallel_jaw import HAND as JAW
from scipy.spatial.transform import Rotation

GRASP, TARGET = "/dgeval/belief/grasp", "/dgeval/belief/target_pose"
VELOCITY, COMMAND = "/dgeval/belief/velocity", "/dgeval/belief/twist_command"
MASK, MODEL = "/dgeval/belief/mask", "/dgeval/belief/model"
COLOUR, DEPTH, JOINTS = "/camera/color/image", "/camera/depth/image", "/joint_states"

CLOSE_NS = 100_000_000_000
TABLE = 0.10  # m, height of the table
HALF = np.array([0.03, 0.02, 0.05])  # m, half the box
CENTRE = np.array([0.5, -0.2, TABLE + HALF[2]])  # of the box at the close
OBJECT_VELOCITY = np.array([0.06, 0.08, 0.0])  # 0.1 m/s along (0.6, 0.8, 0)
TABLE_PLANE = Plane(np.array([0.0, 0.0, 1.0]), -TABLE, 1.0)
T_OBJECT_MODEL = np.eye(4)
T_OBJECT_MODEL[:3, :3] = Rotation.from_euler("xyz", [150.0, 20.0, -70.0], degrees=True).as_matrix()
T_OBJECT_MODEL[:3, 3] = [0.1, -0.3, 0.6]
YAW = 0.3  # rad, of the box
HAND_VELOCITY, HAND_TURN = np.array([0.05, -0.02, -0.10]), np.array([0.0, 0.0, 0.4])  # m/s, rad/s
HAND_AT_CLOSE = np.eye(4)
HAND_AT_CLOSE[:3, :3] = Rotation.from_euler("xyz", [170.0, -15.0, 40.0], degrees=True).as_matrix()
HAND_AT_CLOSE[:3, 3] = CENTRE + np.array([-0.04, 0.02, 0.18])


def ns(seconds: float) -> int:
    """Time stamp of so many seconds after the close command."""
    return CLOSE_NS + round(seconds * 1e9)


def shift(offset: Sequence[float] | Array) -> Array:
    """T (4, 4) that moves by an offset (3,) m."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T


def turn(axis: str, degrees: float | Sequence[float]) -> Array:
    """T (4, 4) that turns about an axis through the origin, or about several, fixed ones."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return T


def every(period: float, first: float, last: float) -> list[float]:
    """Times from first to last, s, both among them."""
    return [round(first + k * period, 9) for k in range(round((last - first) / period) + 1)]


# the object


def box_grid(n: int = 7) -> Array:
    """Points of a regular grid on the faces of the box, symmetric about its centre, object
    frame.
    """
    u = np.linspace(-1, 1, n)
    cube = np.stack(np.meshgrid(u, u, u), axis=-1).reshape(-1, 3)
    return cube[np.abs(cube).max(axis=1) == 1] * HALF


def box_at(seconds: float, centre: Array = CENTRE, velocity: Array = OBJECT_VELOCITY) -> Array:
    """T_base_object of the undisturbed box."""
    return shift(centre + velocity * seconds) @ turn("z", np.degrees(YAW))


def sighted(
    times: Iterable[float],
    *,
    centre: Array = CENTRE,
    velocity: Array = OBJECT_VELOCITY,
    by: By = "registration",
    moved: Callable[[float], Array] = lambda _: np.eye(4),
) -> list[Sighting]:
    """Sightings without noise. moved: what was done to the object by then, as T (4, 4) of the base
    frame.
    """
    return [
        Sighting(ns(t), moved(t) @ box_at(t, centre, velocity) @ T_OBJECT_MODEL, by) for t in times
    ]


SIGHTED = every(0.04, -1.6, -0.12)


def hindsight_of(
    path_sightings: list[Sighting] | None = None,
    *,
    sightings: list[Sighting] | None = None,
    support: Plane | None = TABLE_PLANE,
    pushed: float | None = None,
    contact: float | None = None,
    n_registered: int | None = None,
) -> Hindsight:
    """Hindsight whose path is smoothed from `path_sightings`; `sightings` are those it lists, the
    same unless given.
    """
    base = sighted(SIGHTED) if path_sightings is None else path_sightings
    listed = base if sightings is None else sightings
    points = transform(invert(T_OBJECT_MODEL), box_grid())
    return Hindsight(
        path=smooth(base, points.mean(axis=0)),
        sightings=tuple(listed),
        points=points,
        support=support,
        contact_ns=None if contact is None else ns(contact),
        contact_link=None,
        pushed_ns=None if pushed is None else ns(pushed),
        n_registered=len(listed) if n_registered is None else n_registered,
        gap_s=None,
        gap_sided="none",
        moments=(),
        notes=(),
    )


# the robot


def hand_at(
    seconds: float,
    at_close: Array = HAND_AT_CLOSE,
    velocity: Array = HAND_VELOCITY,
    rate: Array = HAND_TURN,
) -> Array:
    """T_base_hand (the frame hand_base) of a hand at constant twist."""
    T = at_close.copy()
    T[:3, :3] = Rotation.from_rotvec(rate * seconds).as_matrix() @ at_close[:3, :3]
    T[:3, 3] += velocity * seconds
    return T


def hand_poses(
    times: Iterable[float], pose: Callable[[float], Array] = hand_at
) -> list[StampedPose]:
    """What tf says of the hand."""
    return [stamped(t, pose(t), "base_link", "hand_base") for t in times]


def joint_position(name: str, seconds: float) -> float:
    """Of a joint: its own preshape, from the close command on its own speed; no two alike, rad."""
    k = hand.JOINT_NAMES.index(name)
    return 0.01 * k + (0.5 + 0.02 * k) * max(0.0, seconds)


def joint_samples(times: Iterable[float]) -> list[JointSample]:
    return [
        JointSample(ns(t), {name: joint_position(name, t) for name in hand.JOINT_NAMES})
        for t in times
    ]


def stamped(seconds: float, T: Array, parent: str = "base_link", child: str = "") -> StampedPose:
    return StampedPose(ns(seconds), parent, child, pose_from_matrix(T))


def twist(
    seconds: float, linear: Sequence[float] | Array, angular: Sequence[float] | Array = (0, 0, 0)
) -> tuple[int, Array]:
    return ns(seconds), np.array([*linear, *angular], dtype=float)


# the robot's beliefs

T_MODEL_OWN = np.eye(4)  # the robot's model frame in hindsight's
T_MODEL_OWN[:3, :3] = Rotation.from_euler("xyz", [-40.0, 25.0, 110.0], degrees=True).as_matrix()
T_MODEL_OWN[:3, 3] = [-0.2, 0.15, 0.05]


def camera_at(seconds: float) -> Array:
    """T_base_camera of the camera on the hand at constant twist."""
    return np.asarray(hand_at(seconds) @ hand.T_hand_camera)


def palm_at(seconds: float) -> Array:
    """T_base_palm of the hand at constant twist."""
    return np.asarray(hand_at(seconds) @ hand.T_hand_palm)


def believed(seconds: float, error: Array, T_moved: Array | None = None) -> StampedPose:
    """The robot's pose of its object model in the camera frame, off the object by an error (3,) m
    of the base frame.

    T_moved: what was done to the object by then.
    """
    there = box_at(seconds) if T_moved is None else T_moved @ box_at(seconds)
    T_base_own = shift(error) @ there @ T_OBJECT_MODEL @ T_MODEL_OWN
    return stamped(seconds, invert(camera_at(seconds)) @ T_base_own, "camera")


def own_model(n: int = 3000) -> Array:
    """Points (n, 3) of the robot's own model of the box, all round, in its own model frame."""
    rng = np.random.default_rng(0)
    areas = np.array([HALF[1] * HALF[2], HALF[0] * HALF[2], HALF[0] * HALF[1]])
    points = rng.uniform(-1, 1, (n, 3))
    axes = rng.choice(3, n, p=areas / areas.sum())
    points[np.arange(n), axes] = rng.choice([-1.0, 1.0], n)
    return transform(invert(T_OBJECT_MODEL @ T_MODEL_OWN), points * HALF)


@cache
def urdf_of(gripper: str = "fingers") -> str:
    """The description of dgeval's own arm with the DLR-HIT KnownHand II or the parallel jaw."""
    chosen: KnownHand = FIVE_FINGERS if gripper == "fingers" else JAW
    return urdf.robot_urdf(chosen.T_hand_camera, chosen)


# the container


class Container:
    """A recording in memory that holds the robot's object models only; clouds are decoded as a
    PointCloud2 is.
    """

    kind = "memory"
    checksums = "none"

    def __init__(self, models: Sequence[tuple[float, Array]]) -> None:
        self.path = Path("synthetic.mcap")
        self.damage: list[Any] = []
        self.notes: list[str] = []
        self.topics = (
            {MODEL: Topic(MODEL, "sensor_msgs/msg/PointCloud2", "cdr", None, _cloud)}
            if models
            else {}
        )
        self._messages = [
            RawMessage(MODEL, ns(t), points.astype("<f4").tobytes()) for t, points in models
        ]

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        return (m for m in self._messages if m.topic in topics)


def _cloud(data: bytes) -> Any:
    fields = [SimpleNamespace(name=n, datatype=7, offset=4 * k) for k, n in enumerate("xyz")]
    return SimpleNamespace(
        fields=fields,
        is_bigendian=False,
        point_step=12,
        width=len(data) // 12,
        height=1,
        data=np.frombuffer(data, np.uint8),
    )


# the trial

RECORDED = every(0.02, -2.0, 1.0)


def trial_of(
    *,
    hands: list[StampedPose] | None = None,
    joints: list[JointSample] | None = None,
    close: float | None = 0.0,
    first: float = -2.0,
    last: float = 1.0,
    description: str | None = "own",
    poses: Mapping[str, list[StampedPose]] | None = None,
    twists: Mapping[str, list[tuple[int, Array]]] | None = None,
    masks: Iterable[float] | None = None,
    models: Sequence[tuple[float, Array]] = (),
    config: Config | None = None,
) -> Trial:
    """A trial with images from `first` to `last`. hands: tf of hand_base; masks: when the robot saw
    the object itself.
    """
    config = config or Config()
    opened = Opened(Container(models), Path("synthetic.mcap"))
    found = Scan(opened)
    text = urdf_of() if description == "own" else description
    if text is not None:
        found.descriptions["/robot_description"] = text
    found.images[COLOUR] = ImageHead("rgb8", 64, 48, urdf.CAMERA_FRAME, "rgb8")
    found.tf[""].moving.extend(hand_poses(RECORDED) if hands is None else hands)
    found.joints[JOINTS] = joint_samples(RECORDED) if joints is None else joints
    for topic, listed in (poses or {}).items():
        found.poses[topic] = listed
    for topic, given in (twists or {}).items():
        found.twists[topic] = given
    if masks is not None:
        stamps = [ns(t) for t in masks]
        found.times[MASK] = TopicTimes(stamps, stamps)
    roles = Roles(COLOUR, DEPTH, None, JOINTS, None, None, joints=(JOINTS,))
    pairs = tuple(Pair(ns(t), k, k) for k, t in enumerate(every(0.05, first, last)))
    robot = robot_states(found, roles, config)
    camera = Camera(Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5), None, None)
    events = Events(() if close is None else (Event(ns(close), "close", {}),))
    return Trial(
        spec=TrialSpec("synthetic", Path("synthetic.mcap")),
        sha256="",
        config=config,
        opened=opened,
        scan=found,
        roles=roles,
        robot=robot,
        window=Window(pairs[0].t_ns, pairs[-1].t_ns, pairs, 0, 0, {}),
        events=events,
        close=CloseKnown(
            events,
            None if close is None else "event",
            None,
            "",
            None if close is None else ns(close),
        ),
        reader=FrameReader(opened, COLOUR, DEPTH, pairs, camera, robot, LostFrames([])),
        checks=(),
        notes=(),
    )
