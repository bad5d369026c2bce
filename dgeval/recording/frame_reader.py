"""The paired images of a trial as frames, in time order, with the robot at each one's time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgeval.errors import Damage, Place, UndecodableError, UnreadableError
from dgeval.recording.camera import Camera
from dgeval.recording.containers.container import Opened, RawMessage
from dgeval.recording.frame import Frame, MarkedThing
from dgeval.recording.images import colour_from, decode_image
from dgeval.recording.pairing import Pair
from dgeval.recording.robot import RobotStates
from dgeval.recording.video import VideoDecoder

MAX_WAITING = 64  # images of one role held in memory while their partners are waited for


@dataclass
class LostFrames:
    """Counts pairs of images that could not be made into a frame, over all passes over a trial.

    A pair that several passes read counts once. Only the first one is listed, as a damage of the
    recording.
    """

    damage: list[Damage]
    times: set[int | None] = field(default_factory=set)
    is_listed: bool = False

    @property
    def count(self) -> int:
        return len(self.times)

    def add(self, reason: str, place: Place) -> None:
        self.times.add(place.t_ns)
        if self.count == 1 and not self.is_listed:
            self.is_listed = True
            what = f"a frame can't be used ({reason}); further ones are counted"
            self.damage.append(Damage(what, place))


@dataclass(frozen=True)
class FrameReader:
    """Reads a trial's frames from its recording, as often as it is asked to.

    codec: of colour as video. marked: what the log marks, by the time of its picture, ns.
    accepted: which frames the robot merged, likewise.
    """

    opened: Opened
    colour_topic: str
    depth_topic: str
    pairs: tuple[Pair, ...]
    camera: Camera
    robot: RobotStates
    lost: LostFrames = field(compare=False)
    codec: str | None = None
    marked: Mapping[int, tuple[MarkedThing, ...]] = field(default_factory=dict)
    accepted: Mapping[int, bool] = field(default_factory=dict)

    def frames(self) -> Iterator[Frame]:
        """Frames in the order of their stamps, index from 0.

        A pair whose images can't be decoded is counted in `lost` and takes no index.
        UnreadableError where partners lie too far apart in the file.
        """
        index_by_colour = {p.colour: i for i, p in enumerate(self.pairs)}
        index_by_depth = {p.depth: i for i, p in enumerate(self.pairs)}
        waiting: dict[int, dict[str, Any]] = {}
        ordinal = {"colour": -1, "depth": -1}
        next_pair = 0
        n_given = 0
        role_of = {self.colour_topic: "colour", self.depth_topic: "depth"}
        video = None if self.codec is None else VideoDecoder(self.codec)
        for message in self._messages(frozenset(role_of)):
            arrived: list[tuple[str, int, Any]]
            if message is None:  # after the last one
                arrived = [] if video is None else [("colour", k, p) for k, p in video.rest()]
            elif role_of[message.topic] == "colour" and video is not None:
                ordinal["colour"] += 1
                pictures = video.feed(self._video_bytes(message))
                arrived = [("colour", k, picture) for k, picture in pictures]
            else:
                role = role_of[message.topic]
                ordinal[role] += 1
                arrived = [(role, ordinal[role], message)]
            for role, number, held in arrived:
                index = (index_by_colour if role == "colour" else index_by_depth).get(number)
                if index is not None and index >= next_pair:
                    waiting.setdefault(index, {})[role] = held
            if video is not None:
                # pictures come in order: what is behind the newest one does not come any more
                newest = max((k for role, k, _ in arrived if role == "colour"), default=-1)
                is_over = message is None
                while next_pair < len(self.pairs) and "colour" not in waiting.get(next_pair, {}):
                    if not is_over and self.pairs[next_pair].colour >= newest:
                        break
                    waiting.pop(next_pair, None)
                    self._lose(self.pairs[next_pair].t_ns, "its video picture can't be decoded")
                    next_pair += 1
            if len(waiting) > MAX_WAITING:
                raise UnreadableError(
                    f"colour and depth lie more than {MAX_WAITING} frames apart in the file",
                    Place(str(self.opened.path)),
                    "sort it by time",
                )
            while next_pair in waiting and len(waiting[next_pair]) == 2:
                both = waiting.pop(next_pair)
                t_ns = self.pairs[next_pair].t_ns
                frame = self._frame(n_given, t_ns, both["colour"], both["depth"])
                next_pair += 1
                if frame is not None:
                    n_given += 1
                    yield frame
            if next_pair == len(self.pairs):
                return

    def _messages(self, topics: frozenset[str]) -> Iterator[RawMessage | None]:
        """The messages of the topics, and None after the last."""
        yield from self.opened.messages(topics)
        yield None

    def _video_bytes(self, message: RawMessage) -> bytes:
        """Nothing, which no picture comes from, where the message can't be decoded."""
        try:
            return bytes(memoryview(self.opened.decode(message).data))
        except UndecodableError:
            return b""

    def _frame(
        self,
        index: int,
        t_ns: int,
        colour_raw: RawMessage | NDArray[np.uint8],
        depth_raw: RawMessage,
    ) -> Frame | None:
        """A frame of two messages, or of a picture and a message; None where it is lost."""
        try:
            decoded = None
            if isinstance(colour_raw, RawMessage):
                decoded = self.opened.decode(colour_raw)
                colour = colour_from(decode_image(decoded))
            else:
                colour = colour_raw
            depth = self.camera.metres(decode_image(self.opened.decode(depth_raw)))
            colour, depth = self.camera.straight(colour, depth)
        except (UndecodableError, ValueError) as error:
            self._lose(t_ns, str(error))
            return None
        intrinsics = self.camera.intrinsics
        size = (intrinsics.height, intrinsics.width)
        if colour.shape[:2] != size or depth.shape != size:
            self._lose(
                t_ns,
                f"colour {colour.shape[1]}x{colour.shape[0]}, "
                f"depth {depth.shape[1]}x{depth.shape[0]}, "
                f"intrinsics {size[1]}x{size[0]}: not the same size",
            )
            return None
        if self.camera.static_mask is not None:
            depth[self.camera.static_mask > 0] = 0.0
        return Frame(
            index,
            t_ns,
            colour,
            depth,
            intrinsics,
            self.robot.T_base_camera(t_ns),
            self.robot.T_base_palm(t_ns),
            self.robot.hand_shapes(t_ns),
            self._as_recorded(decoded),
            self.marked.get(t_ns, ()),
            self.accepted.get(t_ns),
        )

    def _as_recorded(self, decoded: Any) -> bytes | None:
        """The bytes of a compressed picture; None where the frame shows another one."""
        if self.camera.lens is not None or not hasattr(decoded, "format"):
            return None
        return bytes(memoryview(decoded.data))

    def _lose(self, t_ns: int, reason: str) -> None:
        self.lost.add(reason, Place(str(self.opened.path), t_ns=t_ns))
