"""How a recording's images become metres: the camera's intrinsics, depth scale and static mask."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os.path import commonpath

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import CalibrationConfig
from dgeval.errors import Place, UnreadableError, UsageError
from dgeval.geometry import Array, Intrinsics, matrix_from_pose
from dgeval.recording.alignment import Alignment
from dgeval.recording.image_codecs.pixels import Pixels
from dgeval.recording.images import depth_from
from dgeval.recording.lens import Lens, lens_of
from dgeval.recording.librealsense import DEPTH_TO_COLOUR
from dgeval.recording.messages import CAMERA_INFO, CameraModel
from dgeval.recording.roles import Roles, aligned
from dgeval.recording.scan import ImageHead, Scan
from dgeval.recording.transforms import TransformTree

LEAST_APART_M = 0.003  # m, between two sensors of one device at least; ours
SAME_SHAPE = 0.02  # by which the sides' ratio of a picture that was resized may change; ours


@dataclass(frozen=True)
class Camera:
    """The colour camera, to which depth is aligned.

    depth_scale: m per unit of integer depth, None for the ROS convention. static_mask (H, W):
    depth is dropped where it is not 0; None without one. alignment: of depth that has its own
    camera; None for depth that is aligned as recorded. lens, depth_lens: of the colour and of the
    depth pictures; None without distortion. notes: what was assumed. doubt: what makes the
    alignment doubtful, "" without. depth_offset_m: what is added to all depth, m. depth_shrunk: how
    wide a depth picture is that counts as resized, as share of its camera_info's width; 1.0 where
    both are alike.
    """

    intrinsics: Intrinsics
    depth_scale: float | None
    static_mask: NDArray[np.uint8] | None
    notes: tuple[str, ...] = ()
    alignment: Alignment | None = None
    lens: Lens | None = None
    depth_lens: Lens | None = None
    doubt: str = ""
    depth_offset_m: float = 0.0
    depth_shrunk: float = 1.0

    def metres(self, pixels: Pixels) -> NDArray[np.float32]:
        """Depth (H, W) float32 m as it is recorded, 0 where there is no reading.

        ValueError for a picture that is no depth.
        """
        depth = depth_from(pixels, self.depth_scale)
        if self.depth_offset_m:
            known = depth > 0
            depth[known] = np.maximum(depth[known] + np.float32(self.depth_offset_m), 0)
        return depth

    def straight(
        self, colour: NDArray[np.uint8], depth: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """A pair of pictures without distortion, depth in the colour image.

        ValueError for pictures of another size.
        """
        if self.lens is not None:
            colour = self.lens.colour(colour)
        if self.depth_lens is not None:
            depth = self.depth_lens.depth(depth)
        if self.alignment is not None:
            depth = self.alignment.apply(depth)
        return colour, depth


def camera_of(
    scan: Scan,
    colour_topic: str,
    depth_topic: str,
    roles: Roles,
    tree: TransformTree,
    t_ns: int,
    config: CalibrationConfig,
) -> Camera:
    """Intrinsics, mask, and how depth gets into the colour image.

    t_ns: of an image, at which the transform between the cameras is looked up. UsageError without
    intrinsics or for a bad mask; UnreadableError for depth that can't be aligned.
    """
    intrinsics, notes, lens = _intrinsics(scan, colour_topic, roles.intrinsics, config)
    alignment, depth_lens, doubt, shrunk = None, lens, "", 1.0
    if not aligned(scan, colour_topic, depth_topic):
        alignment, depth_lens = _alignment(
            scan, colour_topic, depth_topic, roles.depth_intrinsics, intrinsics, tree, t_ns, config
        )
        head, stated = scan.images[depth_topic], scan.cameras.get(roles.depth_intrinsics or "")
        frames = head.frame_id, scan.images[colour_topic].frame_id
        is_stated = stated is not None
        if stated is not None and head.width and stated.intrinsics.width:
            shrunk = head.width / stated.intrinsics.width
            if shrunk != 1.0:
                notes.append(
                    f"{depth_topic} is {head.width}x{head.height}, its camera_info "
                    f"{roles.depth_intrinsics} of {stated.intrinsics.width}x"
                    f"{stated.intrinsics.height}: taken as resized"
                )
        if is_stated and alignment.depth == intrinsics and config.T_colour_depth is None:
            # no two sensors are alike to the last digit
            apart = float(np.linalg.norm(alignment.T_colour_depth[:3, 3]))
            if apart > LEAST_APART_M:
                doubt = (
                    f"depth has exactly colour's intrinsics, and its frame {frames[0]!r} is "
                    f"{apart * 1000:.0f} mm from {frames[1]!r}: is it aligned to colour already?"
                )
        if depth_lens is not None:
            notes.append(
                f"the depth camera's lens distortion of up to {depth_lens.most_px:.1f} px is taken "
                "out"
            )
        notes.append(
            f"depth of {depth_topic} ({frames[0]}) is brought into the colour camera ({frames[1]})"
        )
    scale = config.depth_scale
    if scale is None and scan.images[depth_topic].encoding != "32FC1":
        scale = _stated_unit(scan, depth_topic)
    mask = _static_mask(config, intrinsics)
    if mask is not None and lens is not None:
        mask = lens.mask(mask)
    offset_m = config.depth_offset_m
    return Camera(
        intrinsics, scale, mask, tuple(notes), alignment, lens, depth_lens, doubt, offset_m, shrunk
    )


def _stated_unit(scan: Scan, depth_topic: str) -> float | None:
    """m per unit, where the recorder stated the depth sensor's option; None without."""
    near = sorted(scan.depth_units, key=lambda n: (-len(commonpath([n, depth_topic])), n))
    unit = scan.depth_units[near[0]] if near else None
    return unit if unit is not None and np.isfinite(unit) and unit > 0 else None


def _by_the_driver(scan: Scan, depth_topic: str) -> Array | None:
    """T_colour_depth as realsense-ros publishes it beside the pictures; None without."""
    named = [n for n in sorted(scan.extrinsics) if n.endswith(DEPTH_TO_COLOUR)]
    near = sorted(named, key=lambda n: -len(commonpath([n, depth_topic])))
    return scan.extrinsics[near[0]] if near else None


def _alignment(
    scan: Scan,
    colour_topic: str,
    depth_topic: str,
    info_topic: str | None,
    colour: Intrinsics,
    tree: TransformTree,
    t_ns: int,
    config: CalibrationConfig,
) -> tuple[Alignment, Lens | None]:
    c, d = scan.images[colour_topic], scan.images[depth_topic]
    T = None
    if config.T_colour_depth is not None:
        T = matrix_from_pose(np.array(config.T_colour_depth))
    elif c.frame_id and d.frame_id:
        T = tree.lookup(c.frame_id, d.frame_id, t_ns)
    if T is None:
        T = _by_the_driver(scan, depth_topic)
    model = scan.cameras.get(info_topic or "")
    missing = []
    if T is None:
        missing.append("the transform between them (set calibration.T_colour_depth)")
    if model is None and (d.width, d.height) != (c.width, c.height):
        missing.append("the depth camera's camera_info")
    if missing or T is None:
        raise UnreadableError(
            f"depth ({depth_topic}: {d.width}x{d.height}, frame {d.frame_id!r}) is not aligned to "
            f"colour ({colour_topic}: {c.width}x{c.height}, frame {c.frame_id!r}), and "
            f"{' and '.join(missing)} is not recorded",
            Place(str(scan.opened.path)),
            "record depth aligned to colour (realsense: align_depth.enable:=true)",
        )
    if model is None:
        return Alignment(colour, colour, T), None
    used = _of_picture(model, depth_topic)
    is_rectified = used is not model.intrinsics
    used = _sized(used, d)
    if d.width and (used.width, used.height) != (d.width, d.height):
        resized = _resized(used, d)
        if resized is None:
            raise UnreadableError(
                f"{depth_topic} is {d.width}x{d.height}, and its camera_info {info_topic} is of "
                f"{used.width}x{used.height}",
                Place(str(scan.opened.path)),
                "record the camera_info of its own pictures",
            )
        used = resized
    lens = None if is_rectified else lens_of(model, used)[0]
    return Alignment(used, colour, T), lens


def _of_picture(model: CameraModel, topic: str) -> Intrinsics:
    """P for a rectified picture, by its name, K for another."""
    if "rect" in topic.lower() and model.rectified is not None:
        return model.rectified
    return model.intrinsics


def _sized(intrinsics: Intrinsics, head: ImageHead) -> Intrinsics:
    """With the picture's size where none is stated."""
    if intrinsics.width * intrinsics.height:
        return intrinsics
    return replace(intrinsics, width=head.width, height=head.height)


def _intrinsics(
    scan: Scan, colour_topic: str, info_topic: str | None, config: CalibrationConfig
) -> tuple[Intrinsics, list[str], Lens | None]:
    head = scan.images[colour_topic]
    if config.intrinsics is not None:
        return Intrinsics(head.width, head.height, *config.intrinsics), [], None
    model = scan.cameras.get(info_topic or "")
    if model is None:
        others = ", ".join(
            f"{n} (frame {m.frame_id!r}, {m.intrinsics.width}x{m.intrinsics.height})"
            for n, m in sorted(scan.cameras.items())
        )
        of = f" of {colour_topic} (frame {head.frame_id!r})" if others else ""
        unread = "; ".join(
            f"{name} can't be used: {why}"
            for name, why in sorted(scan.first_undecodable.items())
            if scan.opened.topics[name].type == CAMERA_INFO
        )
        raise UsageError(
            f"no camera intrinsics{of} recorded"
            + (f"; there are {others}" if others else "")
            + (f"; {unread}" if unread else ""),
            Place(str(scan.opened.path)),
            "give --set 'calibration.intrinsics=[fx, fy, cx, cy]'",
        )
    notes = []
    used = _of_picture(model, colour_topic)
    is_rectified = used is not model.intrinsics
    if head.width and not used.width * used.height:
        if not (0.3 < used.cx / head.width < 0.7 and 0.3 < used.cy / head.height < 0.7):
            raise UsageError(
                f"{info_topic} states no size, and its middle ({used.cx:.0f}, {used.cy:.0f}) is "
                f"not that of {colour_topic}, {head.width}x{head.height}",
                Place(str(scan.opened.path)),
                "give --set 'calibration.intrinsics=[fx, fy, cx, cy]'",
            )
        notes.append(f"{info_topic} states no size: taken for that of {colour_topic}")
        used = _sized(used, head)
    if head.width and (used.width, used.height) != (head.width, head.height):
        raise UsageError(
            f"{colour_topic} is {head.width}x{head.height}, and its camera_info {info_topic} is of "
            f"{used.width}x{used.height}",
            Place(str(scan.opened.path)),
            _other_size(head, used),
        )
    lens = None
    if not is_rectified:
        lens, note = lens_of(model, used)
        notes += [note] if note else []
    unusable = [
        n for n in sorted(scan.first_undecodable) if scan.opened.topics[n].type == CAMERA_INFO
    ]
    if unusable:
        notes.append(
            f"{', '.join(unusable)} can't be used: the intrinsics are those of {info_topic}"
        )
    n_others = scan.camera_changes.get(info_topic or "", 0)
    if n_others:
        notes.append(
            "the intrinsics change within the recording: those of most messages are used, "
            f"{n_others} have others"
        )
    return used, notes, lens


def _resized(stated: Intrinsics, head: ImageHead) -> Intrinsics | None:
    """Those of a picture that was resized to another size; None where its sides' ratio differs."""
    x, y = head.width / stated.width, head.height / stated.height
    if abs(x / y - 1) >= SAME_SHAPE:
        return None
    middle = (stated.cx + 0.5) * x - 0.5, (stated.cy + 0.5) * y - 0.5
    return Intrinsics(head.width, head.height, stated.fx * x, stated.fy * y, *middle)


def _other_size(head: ImageHead, stated: Intrinsics) -> str:
    """What mends intrinsics of another size than the picture's."""
    resized = _resized(stated, head)
    if resized is not None:
        scaled = (resized.fx, resized.fy, resized.cx, resized.cy)
        numbers = ", ".join(f"{v:.6g}" for v in scaled)
        return f"if the picture was resized: --set 'calibration.intrinsics=[{numbers}]'"
    asked = "give the picture's own: --set 'calibration.intrinsics=[fx, fy, cx, cy]'"
    if (stated.height, stated.width) == (head.width, head.height):
        return f"width and height are swapped, or the picture is turned by 90 degrees: {asked}"
    return f"the picture was cut: {asked}"


def _static_mask(config: CalibrationConfig, camera: Intrinsics) -> NDArray[np.uint8] | None:
    if config.static_mask is None:
        return None
    mask = cv2.imread(config.static_mask, cv2.IMREAD_GRAYSCALE)
    if mask is None or mask.shape != (camera.height, camera.width):
        raise UsageError(
            f"calibration.static_mask is not an image of {camera.width}x{camera.height}",
            Place(config.static_mask),
        )
    return np.asarray(mask, dtype=np.uint8)
