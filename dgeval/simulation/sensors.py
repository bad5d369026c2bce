"""A stereo depth camera's errors on an exact depth image, and its alignment to the colour camera.

Optical frames: x right, y down, z forward. The depth image is that of the LEFT imager; the right
one sits at +x, one baseline away. Depth is along the optical axis, not along the ray.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics
from dgeval.simulation.depth_kernels import draw_rectangles, measure, shadow

Image32 = NDArray[np.float32]
DepthImage = NDArray[np.uint16]

DEPTH_IMAGER = (1280, 800)  # px, D400 depth imagers
COLOUR_IMAGER = (1920, 1080)  # px, D435 colour imager


@dataclass(frozen=True, slots=True)
class DepthProfile:
    """One camera model.

    Probabilities, angles and windows are ours unless a comment gives another source.
    """

    name: str
    baseline: float  # m
    # px of the depth imager in the 640x480 stream; `depth_intrinsics` gives it for other streams
    focal: float
    min_range: float  # m, nothing is measured nearer
    max_range: float  # m
    colour_offset: float = 0.0  # m, x of the colour camera in the depth frame
    # deg over the full width of the colour imager; None: colour from the depth imager
    colour_hfov: float | None = None
    subpixel_sigma: float = 0.08  # px of disparity, 1 sigma on a fronto-parallel surface
    # px, sigma of the Gaussian kernel that makes the noise smooth over a matching window
    correlation: float = 2.0
    # sigma grows by this share per px of disparity change from a pixel to the next
    slope_gain: float = 2.0
    quantum: float = 1 / 32  # px of disparity, the step of the matcher's output
    depth_unit: float = 0.001  # m per count
    ramp: float = 0.1  # losses fall from all to none over this share of the minimum range beyond it
    # px of disparity within 5x5 px, beyond what the slope explains, that makes a depth edge
    jump: float = 1.0
    flying: float = 0.35  # probability of a value between the two surfaces at an edge
    edge_hole: float = 0.30  # probability of no value at an edge
    grazing: float = 65.0  # deg of incidence above which some are lost
    grazing_loss: float = 0.4  # probability of that
    grazing_limit: float = 80.0  # deg of incidence above which all are lost


# D435: 0.28 m is the minimum range of the 1280x720 stream (data sheet). It is taken for every
# size, as if images were taken at 1280x720 and scaled down: the simulator must be able to show a
# loss of depth over the last decimetres before the grasp. A true 640x480 stream would begin at
# 0.175 m, 424x240 at 0.105 m; use dataclasses.replace for those. The noise is nevertheless that
# of the small stream, the worse of the two.
# The colour camera lies on the far side of the left imager from the right one: Depth to Color has
# +15 mm in the calibrations in realsense-ros #2788, so the camera itself is at -15 mm.
D435 = DepthProfile("D435", 0.050, 385.0, 0.28, 10.0, colour_offset=-0.015, colour_hfov=69.0)
# D405: 84 degrees over the 1280 px of the imager (librealsense #11427), 0.6 of that scale in
# 640x480. Its ideal range is 0.07-0.5 m; beyond that it measures with growing noise.
D405 = DepthProfile("D405", 0.018, 0.6 * 640 / math.tan(math.radians(42.0)), 0.07, 2.0)
PROFILES = {profile.name: profile for profile in (D435, D405)}


def _stream(focal: float, imager: tuple[int, int], width: int, height: int) -> Intrinsics:
    """Intrinsics of a stream cut from the middle of the imager at the scale that just fills it.

    focal, px: of the full imager.
    """
    f = focal * max(width / imager[0], height / imager[1])
    return Intrinsics(width, height, f, f, (width - 1) / 2, (height - 1) / 2)


def depth_intrinsics(profile: DepthProfile, width: int, height: int) -> Intrinsics:
    """Depth camera of a stream.

    4:3 streams lose the sides of the imager, so the focal length does not scale with width alone.
    For a D435: 385 px in 640x480, 212.6 in 424x240, 641.7 in 1280x720; real ones have 383, 211.4,
    638 (librealsense #3474).
    """
    return _stream(
        profile.focal / max(640 / DEPTH_IMAGER[0], 480 / DEPTH_IMAGER[1]),
        DEPTH_IMAGER,
        width,
        height,
    )


def colour_intrinsics(profile: DepthProfile, width: int, height: int) -> Intrinsics:
    """Colour camera of a stream.

    For a D435: 621 px in 640x480, 308 in 424x240; a real one has 612, 306 (librealsense #7300).
    """
    if profile.colour_hfov is None:
        return depth_intrinsics(profile, width, height)
    focal = COLOUR_IMAGER[0] / 2 / math.tan(math.radians(profile.colour_hfov / 2))
    return _stream(focal, COLOUR_IMAGER, width, height)


def colour_from_depth(profile: DepthProfile) -> Array:
    """T_colour_depth (4, 4) of the profile: it moves points against the offset of the camera."""
    T = np.eye(4)
    T[0, 3] = -profile.colour_offset
    return T


def measure_depth(
    exact: Image32, camera: Intrinsics, profile: DepthProfile, rng: np.random.Generator
) -> DepthImage:
    """The depth image that the camera reports of an exact one.

    exact (H, W) m: 0 or not finite where there is no surface. Returns counts of `depth_unit` (H,
    W), 0 where nothing is measured. Errors arise where a stereo camera makes them, in disparity d =
    f B / z px: sigma_z = z^2 sigma_d / (f B) (the formula of Intel's tuning paper;
    ethz-asl/rotors_simulator, D435 model). The number of draws does not depend on the image.
    """
    noise, fate, loss = (
        _noise(exact.shape, profile.correlation, rng),
        _patches(exact.shape, rng),
        _patches(exact.shape, rng),
    )
    fB = np.float32(camera.fx * profile.baseline)
    # under a millimetre, squares of the disparity would overflow
    valid = (exact > 0.001) & (exact < np.inf)
    d = np.divide(fB, np.where(valid, exact, np.inf), dtype=np.float32)
    window = np.ones((5, 5), np.uint8)
    far = cv2.erode(np.where(valid, d, np.float32(1e9)), window)
    step = cv2.dilate(d, window) - far
    u = np.arange(camera.width, dtype=np.float32) - np.float32(camera.cx)
    v = np.arange(camera.height, dtype=np.float32) - np.float32(camera.cy)
    out = np.zeros(exact.shape, np.uint16)
    ray2 = (u / np.float32(camera.fx)) ** 2
    # every parameter in single precision, as the images are
    parameters = (
        camera.fx,
        camera.fy,
        profile.jump,
        profile.edge_hole,
        max(profile.flying, 1e-6),
        profile.subpixel_sigma,
        profile.slope_gain,
        profile.quantum,
        profile.min_range,
        profile.ramp * profile.min_range,
        profile.grazing_loss,
        math.cos(math.radians(profile.grazing)),
        profile.max_range,
        math.cos(math.radians(profile.grazing_limit)),
        profile.depth_unit,
    )
    singles = tuple(np.float32(p) for p in parameters)
    measure(out, valid, d, far, step, noise, fate, loss, shadow(d), u, v, ray2, fB, *singles)
    return out


def _noise(shape: tuple[int, ...], correlation: float, rng: np.random.Generator) -> Image32:
    """Smooth noise (H, W) of zero mean and unit variance everywhere.

    It starts from uniform bytes: the kernel sums some fifty of them, which makes them Gaussian at a
    tenth of the cost of normal draws.
    """
    half = math.ceil(2.5 * correlation)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / max(correlation, 1e-6)) ** 2)
    kernel /= np.sqrt((kernel**2).sum())
    # with a margin, so that the kernel has the same sum at the border
    rows, columns = shape[0] + 2 * half, shape[1] + 2 * half
    white = (
        np.frombuffer(rng.bytes(rows * columns), np.uint8).reshape(rows, columns).astype(np.float32)
    )
    white -= np.float32(127.5)
    white *= np.float32(math.sqrt(12 / (256**2 - 1)))
    smooth: Image32 = cv2.sepFilter2D(white, cv2.CV_32F, kernel, kernel)
    return smooth[half : half + shape[0], half : half + shape[1]]


def _patches(shape: tuple[int, ...], rng: np.random.Generator) -> Image32:
    """Uniform [0, 1) draws (H, W), equal over 2x2 px.

    A stereo matcher loses patches rather than single pixels.
    """
    coarse = rng.random(((shape[0] + 1) // 2, (shape[1] + 1) // 2), dtype=np.float32)
    return np.repeat(np.repeat(coarse, 2, 0), 2, 1)[: shape[0], : shape[1]]


def align_to_colour(
    depth: DepthImage,
    depth_camera: Intrinsics,
    colour_camera: Intrinsics,
    T_colour_depth: Array,
    unit: float,
) -> DepthImage:
    """Depth image seen from the colour camera; the nearest surface wins.

    Returns counts of `unit` m along the colour camera's axis. As in librealsense, each depth pixel
    is carried over as the rectangle it covers. Here the rectangle is a quarter pixel larger on each
    side, so that neighbours at slightly different depth leave no crack. Roll between the cameras
    must be small.
    """
    if depth_camera == colour_camera and np.array_equal(T_colour_depth, np.eye(4)):
        return depth.copy()
    out = np.full((colour_camera.height, colour_camera.width), 65535, np.uint16)
    # the middle of each column and row of the depth image on the plane one metre away, and half a
    # pixel there
    x = (np.arange(depth.shape[1], dtype=np.float32) - np.float32(depth_camera.cx)) / np.float32(
        depth_camera.fx
    )
    y = (np.arange(depth.shape[0], dtype=np.float32) - np.float32(depth_camera.cy)) / np.float32(
        depth_camera.fy
    )
    half = np.array([0.5 / depth_camera.fx, 0.5 / depth_camera.fy], np.float32)
    c = colour_camera
    to = np.array([c.fx, c.fy, c.cx, c.cy], np.float32)
    draw_rectangles(out, depth, x, y, half, to, T_colour_depth.astype(np.float32), np.float32(unit))
    out[out == 65535] = 0
    return out
