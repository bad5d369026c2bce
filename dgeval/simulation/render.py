"""Images of a world through its wrist cameras: colour, and depth aligned to colour.

Depth is what a stereo camera measures.
"""

from __future__ import annotations

from types import TracebackType
from typing import Protocol

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from dgeval.determinism import generator
from dgeval.errors import UsageError
from dgeval.simulation.sensors import (
    DepthProfile,
    align_to_colour,
    colour_from_depth,
    measure_depth,
)
from dgeval.worlds.objects import OBJECT_GROUP
from dgeval.worlds.scene import BELT_GROUP, Camera


class Drawable(Protocol):
    """A world that can be drawn."""

    model: mujoco.MjModel
    data: mujoco.MjData


class Renderer:
    """Draws one world's `colour` and `depth` cameras. Close it: graphics memory is not collected.

    `mujoco.Renderer` gives the same pixels in more time: it shades the whole floor before the belt
    hides it, and takes segment numbers apart in 32 bits. Here the floor is drawn last, and segment
    numbers are looked up as bytes.
    """

    def __init__(
        self,
        world: Drawable,
        cameras: tuple[Camera, Camera],
        profile: DepthProfile,
        seed: int,
        index: int,
    ) -> None:
        self.cameras, self.profile = cameras, profile
        self._world, self._seed, self._index = world, seed, index
        size = cameras[0].intrinsics
        model = world.model
        try:
            self._gl = mujoco.GLContext(size.width, size.height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        except Exception as error:
            message = f"images can't be drawn on this machine ({type(error).__name__}: {error})"
            raise UsageError(
                message, hint="on Debian: apt install libegl1 libegl-mesa0 libgl1-mesa-dri"
            ) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._area = mujoco.MjrRect(0, 0, size.width, size.height)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._visible, self._belt, self._floor, self._object = (
            mujoco.MjvOption() for _ in range(4)
        )
        for option in (self._visible, self._belt, self._floor, self._object):
            option.geomgroup[:] = 0
        self._visible.geomgroup[:3], self._belt.geomgroup[BELT_GROUP], self._floor.geomgroup[0] = (
            1,
            1,
            1,
        )
        self._object.geomgroup[OBJECT_GROUP] = 1

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._context.free()
        self._gl.free()

    def _draw(self, camera: str, segments: bool) -> None:
        """Draw the scene as it stands into the offscreen buffer.

        segments: as flat, numbered surfaces.
        """
        model, data, scene, view = (
            self._world.model,
            self._world.data,
            self._scene,
            self._view_of(camera),
        )
        still, moving = mujoco.mjtCatBit.mjCAT_STATIC.value, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        # What stands on the belt touches it, and at equal depth the order of drawing decides. So
        # only the floor, which lies far below, is drawn last.
        mujoco.mjv_updateScene(model, data, self._belt, mujoco.MjvPerturb(), view, still, scene)
        mujoco.mjv_addGeoms(model, data, self._visible, mujoco.MjvPerturb(), moving, scene)
        mujoco.mjv_addGeoms(model, data, self._floor, mujoco.MjvPerturb(), still, scene)
        self._render(segments)

    def _view_of(self, camera: str) -> mujoco.MjvCamera:
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = (
            mujoco.mjtCamera.mjCAMERA_FIXED,
            self._world.model.camera(camera).id,
        )
        return view

    def _render(self, segments: bool) -> None:
        scene = self._scene
        scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = scene.flags[
            mujoco.mjtRndFlag.mjRND_IDCOLOR
        ] = segments
        self._gl.make_current()
        mujoco.mjr_render(self._area, scene, self._context)

    def _pixels(self) -> NDArray[np.uint8]:
        out = np.empty((self._area.height, self._area.width, 3), np.uint8)
        mujoco.mjr_readPixels(out, None, self._area, self._context)
        return out[::-1]

    def _nearness(self) -> NDArray[np.float32]:
        """OpenGL's reversed depth buffer (H, W), bottom row first, 0 where there is no surface."""
        out = np.empty((self._area.height, self._area.width), np.float32)
        mujoco.mjr_readPixels(None, out, self._area, self._context)
        return out

    def images(
        self, frame: int, mask: bool = False
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint16], NDArray[np.bool_] | None]:
        """Colour (H, W, 3) RGB, aligned depth (H, W) in the profile's units, and the object's mask.

        mask: whether to draw the mask, as `mask()` gives it; else it is None. frame: number of the
        frame, for the noise.
        """
        self._draw("colour", False)
        colour = np.ascontiguousarray(self._pixels())
        shown = self._mask_in(self._nearness()) if mask else None
        exact = self.exact_depth("depth")
        measured = measure_depth(
            exact,
            self.cameras[1].intrinsics,
            self.profile,
            generator(self._seed, f"depth/{self._index}", frame),
        )
        camera, depth_camera = self.cameras[0].intrinsics, self.cameras[1].intrinsics
        aligned = align_to_colour(
            measured, depth_camera, camera, colour_from_depth(self.profile), self.profile.depth_unit
        )
        noise = generator(self._seed, f"colour/{self._index}", frame).integers(
            -3, 4, colour.shape, dtype=np.int8
        )
        return np.asarray(cv2.add(colour, noise, dtype=cv2.CV_8U), dtype=np.uint8), aligned, shown

    def _mask_in(self, nearness: NDArray[np.float32]) -> NDArray[np.bool_]:
        """The mask from the depth buffer of the whole scene.

        It holds the pixels where the object, drawn alone, is as near as the scene.
        """
        dynamic = mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        mujoco.mjv_updateScene(
            self._world.model,
            self._world.data,
            self._object,
            mujoco.MjvPerturb(),
            self._view_of("colour"),
            dynamic,
            self._scene,
        )
        self._render(True)
        alone = self._nearness()
        return np.asarray(((alone == nearness) & (alone > 0))[::-1])

    def exact_depth(self, camera: str) -> NDArray[np.float32]:
        """Depth (H, W) m without error, 0 where there is no surface."""
        # flat surfaces: MuJoCo's depth of them is the more exact far away
        self._draw(camera, True)
        depth = self._nearness()
        model = self._world.model
        near, far = (
            np.float32(edge * model.stat.extent)
            for edge in (model.vis.map.znear, model.vis.map.zfar)
        )
        # the buffer holds OpenGL's reversed depth, whose matrix has these two coefficients
        c = np.float32(0.5) * ((far + near) / (far - near)) - np.float32(0.5)
        d = np.float32(0.5) * (np.float32(2) * far * near / (far - near))
        metres = depth[::-1].astype(np.float64)
        metres += c
        exact = np.divide(d, metres, out=metres).astype(np.float32)
        exact[exact > 5.9] = 0.0  # the far plane
        return exact

    def box(self) -> tuple[float, float, float, float] | None:
        """x0 y0 x1 y1 px around the visible part of the object, None if nothing is visible."""
        v, u = np.nonzero(self.mask())
        return (
            (float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1))
            if len(v)
            else None
        )

    def mask(self) -> NDArray[np.bool_]:
        """Pixels (H, W) of the colour image that show the object."""
        model = self._world.model
        return self.mask_of(np.flatnonzero(model.geom_bodyid == model.body("object").id).tolist())

    def mask_of(self, geoms: list[int]) -> NDArray[np.bool_]:
        """Pixels (H, W) of the colour image that show one of the geoms."""
        self._draw("colour", True)
        shown = np.zeros(256, bool)
        assert self._scene.ngeom < 255  # numbers of segments fit into the red byte, from 1 on
        for geom in self._scene.geoms[: self._scene.ngeom]:
            shown[geom.segid + 1] = geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in geoms
        return np.asarray(shown[self._pixels()[:, :, 0]])
