"""From paths and manifests to trials, and from a trial to its frames."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config
from dgeval.errors import Damage, Place, UndecodableError, UnreadableError, UsageError
from dgeval.geometry import Intrinsics, matrix_from_pose
from dgeval.recording.clocks import StampFaults, clean_stamps, pair, tolerance_ns
from dgeval.recording.containers.container import Opened, sha256_of
from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import GRASP_TOPIC, NOTES_KEY, TRIAL_START_EVENT, EventKind
from dgeval.recording.frame import Frame, RecordedGrasp
from dgeval.recording.images import colour_from, decode_image, depth_from
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.messages import Event
from dgeval.recording.robot import RobotStates, robot_states
from dgeval.recording.roles import Roles, find_roles
from dgeval.recording.scan import Scan, scan

MAX_WAITING = 64  # images of one role held while their partners are waited for


@dataclass
class Trial:
    """A trial ready to be read: its pairs of images, robot states, events, and what is wrong with it."""

    spec: TrialSpec
    opened: Opened
    scan: Scan
    roles: Roles
    robot: RobotStates
    camera: Intrinsics
    config: Config
    sha256: str
    pairs: list[tuple[int, int, int]]
    events: list[Event]
    stamp_faults: dict[str, StampFaults]
    n_unmatched_colour: int
    n_unmatched_depth: int
    notes: list[str]
    n_undecodable_frames: int = 0
    static_mask: NDArray[np.uint8] | None = None
    _grasps: list[tuple[int, RecordedGrasp]] = field(default_factory=list)

    @property
    def damage(self) -> list[Damage]:
        return self.opened.damage

    def event_ns(self, kind: EventKind) -> int | None:
        """Time of the first event of a kind in this trial."""
        return next((e.t_ns for e in self.events if e.kind == kind), None)

    def frames(self) -> Iterator[Frame]:
        """Frames in the order of their stamps, index from 0. A frame whose images can't be decoded is counted, not given."""
        colour_of = {c: (i, t) for i, (t, c, _) in enumerate(self.pairs)}
        depth_of = {d: i for i, (_, _, d) in enumerate(self.pairs)}
        waiting: dict[int, dict[str, Any]] = {}
        seen = {"colour": -1, "depth": -1}
        next_pair = 0
        given = 0
        names = {self.roles.colour: "colour", self.roles.depth: "depth"}
        for message in self.opened.messages(frozenset(n for n in names if n)):
            role = names[message.topic]
            seen[role] += 1
            index = (
                colour_of[seen[role]][0] if role == "colour" and seen[role] in colour_of else None
            )
            if role == "depth":
                index = depth_of.get(seen[role])
            if index is None or index < next_pair:
                continue
            waiting.setdefault(index, {})[role] = message
            if len(waiting) > MAX_WAITING:
                what = f"colour and depth lie more than {MAX_WAITING} frames apart in the file"
                raise UnreadableError(
                    what,
                    Place(str(self.spec.recording), message.topic, message.log_ns),
                    "sort it by time",
                )
            while next_pair in waiting and len(waiting[next_pair]) == 2:
                both = waiting.pop(next_pair)
                frame = self._frame(given, self.pairs[next_pair][0], both["colour"], both["depth"])
                next_pair += 1
                if frame is not None:
                    given += 1
                    yield frame
            if next_pair == len(self.pairs):
                return

    def _frame(
        self, index: int, t_ns: int, colour_message: Any, depth_message: Any
    ) -> Frame | None:
        try:
            decoded = self.opened.decode(colour_message)
            colour = colour_from(decode_image(decoded))
            depth = depth_from(
                decode_image(self.opened.decode(depth_message)), self.config.calibration.depth_scale
            )
        except (UndecodableError, ValueError) as error:
            self._lose(t_ns, str(error))
            return None
        size = (self.camera.height, self.camera.width)
        if colour.shape[:2] != size or depth.shape != size:
            what = f"colour {colour.shape[1]}x{colour.shape[0]}, depth {depth.shape[1]}x{depth.shape[0]}, intrinsics "
            self._lose(t_ns, f"{what}{size[1]}x{size[0]}: not the same size")
            return None
        if self.static_mask is not None:
            depth[self.static_mask > 0] = 0.0
        T_base_camera = self.robot.T_base_camera(t_ns)
        at = bisect_right(self._grasps, t_ns, key=lambda g: g[0])
        return Frame(
            index,
            t_ns,
            colour,
            depth,
            self.camera,
            T_base_camera,
            self.robot.T_base_palm(t_ns),
            self.robot.hand_shapes(t_ns),
            self._grasps[at - 1][1] if at else None,
            bytes(memoryview(decoded.data)) if hasattr(decoded, "format") else None,
        )

    def _lose(self, t_ns: int, why: str) -> None:
        self.n_undecodable_frames += 1
        if self.n_undecodable_frames == 1:
            place = Place(str(self.spec.recording), t_ns=t_ns)
            self.opened.damage.append(
                Damage(f"a frame can't be used ({why}); further ones are counted", place)
            )


def open_trial(spec: TrialSpec, config: Config) -> Trial:
    """Scan the recording, find roles, pair images, cut the trial's window out."""
    place = Place(str(spec.recording))
    opened = open_container(spec.recording)
    sha256 = sha256_of(spec.recording)
    if spec.sha256 is not None and spec.sha256.lower() != sha256:
        raise UnreadableError(
            f"sha256 is {sha256}, the manifest says {spec.sha256}: not the recording it names",
            place,
        )
    found = scan(opened, config.roles.events)
    roles = find_roles(found, config.roles)
    if roles.colour is None or roles.depth is None:
        missing = " and ".join(
            n for n, v in (("colour", roles.colour), ("depth", roles.depth)) if v is None
        )
        listed = (
            ", ".join(
                f"{t.name} ({t.type})" for t in sorted(opened.topics.values(), key=lambda t: t.name)
            )
            or "nothing"
        )
        lost = f" after damage ({opened.damage[0].what})" if opened.damage else ""
        hint = "name it with --set roles.colour=… or roles.depth=…"
        raise UnreadableError(f"no {missing} images found{lost} among: {listed}", place, hint)
    robot = robot_states(found, roles, config)
    notes = list(robot.notes)
    camera = _camera(found, roles, config, place, notes)

    if spec.bbox is not None:
        x0, y0, x1, y1 = spec.bbox
        if not (np.isfinite(spec.bbox).all() and x0 < x1 and y0 < y1):
            raise UsageError(
                f"the box {spec.bbox} is not x0, y0, x1, y1 with x0 < x1 and y0 < y1", place
            )
        if x1 <= 0 or y1 <= 0 or x0 >= camera.width or y0 >= camera.height:
            raise UsageError(
                f"the box {spec.bbox} lies outside the image of {camera.width}x{camera.height}",
                place,
            )

    times: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
    faults = {}
    for role, topic in (("colour", roles.colour), ("depth", roles.depth)):
        header, log = found.times[topic].arrays()
        offset = getattr(config.clock, role).offset_ns
        stamps, ordinals, faults[role] = clean_stamps(
            header, log, offset, round(config.sync.jump_s * 1e9)
        )
        times[role] = (stamps, ordinals)
    colour_ns, colour_ordinals = times["colour"]
    depth_ns, depth_ordinals = times["depth"]
    matched = pair(colour_ns, depth_ns, tolerance_ns(colour_ns, config.sync))
    pairs = [
        (int(colour_ns[c]), int(colour_ordinals[c]), int(depth_ordinals[d])) for c, d in matched
    ]
    start = (
        spec.start_ns if spec.start_ns is not None else (int(colour_ns[0]) if len(colour_ns) else 0)
    )
    if spec.frames is not None:
        a, b = spec.frames
        if not 0 <= a < b <= len(pairs):
            raise UsageError(
                f"frames {a}:{b} are not within the recording's {len(pairs)} paired frames", place
            )
        pairs = pairs[a:b]
        start, end = pairs[0][0], pairs[-1][0]
    else:
        end = (
            spec.end_ns
            if spec.end_ns is not None
            else (int(colour_ns[-1]) if len(colour_ns) else 0)
        )
        pairs = [p for p in pairs if start <= p[0] <= end]
    if not pairs:
        what = f"no colour and depth images pair up between {start} and {end} ns"
        if opened.damage:
            what += f" (damage: {opened.damage[0].what})"
        raise UnreadableError(what, place, "see `dgeval inspect` for their stamps")
    inside = (
        ((colour_ns >= start) & (colour_ns <= end)).sum(),
        ((depth_ns >= start) & (depth_ns <= end)).sum(),
    )
    # the last frame's worth of time after the window still belongs to its events
    events = [e for e in found.events if start <= e.t_ns <= end + 1_000_000_000]
    if spec.end_ns is not None:
        events = [e for e in events if e.t_ns <= spec.end_ns]
    grasps = []
    for pose in found.poses.get(GRASP_TOPIC, []):
        near = [s for s in found.scores if s[0] <= pose.t_ns + 1_000_000]
        grasps.append(
            (pose.t_ns, RecordedGrasp(matrix_from_pose(pose.pose), near[-1][1] if near else None))
        )
    for event in events:
        said = event.fields.get(NOTES_KEY)
        if event.kind == TRIAL_START_EVENT and isinstance(said, list):
            notes.extend(str(note) for note in said)
    if any(f.dropped or f.zero for f in faults.values()):
        notes.append(
            "stamps: "
            + ", ".join(
                f"{r} {f.zero} zero, {f.backward} backward, {f.duplicate} duplicate"
                for r, f in sorted(faults.items())
            )
        )
    spec = replace(spec, start_ns=start, end_ns=end)
    return Trial(
        spec, opened, found, roles, robot, camera, config, sha256, pairs, events, faults,
        max(0, int(inside[0]) - len(pairs)), max(0, int(inside[1]) - len(pairs)), notes,
        static_mask=_static_mask(config, camera), _grasps=sorted(grasps, key=lambda g: g[0]),
    )  # fmt: skip


def _camera(
    found: Scan, roles: Roles, config: Config, place: Place, notes: list[str]
) -> Intrinsics:
    assert roles.colour is not None
    head = found.images[roles.colour]
    if config.calibration.intrinsics is not None:
        return Intrinsics(head.width, head.height, *config.calibration.intrinsics)
    model = found.cameras.get(roles.intrinsics or "")
    if model is None:
        raise UsageError(
            "no camera intrinsics recorded",
            place,
            "give --set 'calibration.intrinsics=[fx, fy, cx, cy]'",
        )
    if any(abs(d) > 1e-9 for d in model.distortion):
        notes.append(
            f"lens distortion {[round(d, 4) for d in model.distortion]} is recorded and not removed"
        )
    if found.camera_changes.get(roles.intrinsics or ""):
        notes.append("the intrinsics change within the recording; the first are used")
    return model.intrinsics


def _static_mask(config: Config, camera: Intrinsics) -> NDArray[np.uint8] | None:
    if config.calibration.static_mask is None:
        return None
    place = Place(config.calibration.static_mask)
    mask = cv2.imread(config.calibration.static_mask, cv2.IMREAD_GRAYSCALE)
    if mask is None or mask.shape != (camera.height, camera.width):
        raise UsageError(
            f"calibration.static_mask is not an image of {camera.width}x{camera.height}", place
        )
    return np.asarray(mask, dtype=np.uint8)
