"""Images of a world through its wrist cameras: colour, and depth as a stereo camera measures it, aligned to colour."""

from __future__ import annotations

from types import TracebackType

import mujoco
import numpy as np
from numpy.typing import NDArray

from dgeval.determinism import generator
from dgeval.errors import UsageError
from dgeval.physics.scene import Camera
from dgeval.simulation.sensors import DepthProfile, align_to_colour, colour_from_depth, measure_depth
from dgeval.simulation.world import World


class Eyes:
    """Renderers for one world's `colour` and `depth` cameras. Close it: graphics memory is not collected."""

    def __init__(self, world: World, cameras: tuple[Camera, Camera], profile: DepthProfile, seed: int, index: int) -> None:
        colour = cameras[0].intrinsics
        try:
            self._renderer = mujoco.Renderer(world.model, colour.height, colour.width)
        except Exception as error:
            what = f"images can't be drawn on this machine ({type(error).__name__}: {error})"
            raise UsageError(what, hint="on Debian: apt install libegl1 libegl-mesa0 libgl1-mesa-dri") from error
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = [1, 1, 1, 0, 0, 0]
        self._world, self.cameras, self.profile = world, cameras, profile
        self._seed, self._index = seed, index

    def __enter__(self) -> Eyes:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self._renderer.close()

    def look(self, frame: int) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Colour (H, W, 3) RGB and aligned depth (H, W) in the profile's units, of the world as it stands."""
        data = self._world.data
        self._renderer.update_scene(data, "colour", self._options)
        colour = self._renderer.render().copy()
        exact = self.exact_depth("depth")
        measured = measure_depth(
            exact, self.cameras[1].intrinsics, self.profile, generator(self._seed, f"depth/{self._index}", frame)
        )
        camera, depth_camera = self.cameras[0].intrinsics, self.cameras[1].intrinsics
        aligned = align_to_colour(measured, depth_camera, camera, colour_from_depth(self.profile), self.profile.depth_unit)
        noise = generator(self._seed, f"colour/{self._index}", frame).integers(-3, 4, colour.shape, dtype=np.int8)
        return np.clip(colour.astype(np.int16) + noise, 0, 255).astype(np.uint8), aligned

    def exact_depth(self, camera: str) -> NDArray[np.float32]:
        """Depth (H, W) m without error, 0 where nothing is."""
        self._renderer.update_scene(self._world.data, camera, self._options)
        self._renderer.enable_depth_rendering()
        depth = self._renderer.render().copy()
        self._renderer.disable_depth_rendering()
        depth[depth > 5.9] = 0.0  # the far plane
        return np.asarray(depth, dtype=np.float32)

    def box(self) -> tuple[float, float, float, float] | None:
        """x0 y0 x1 y1 px around what is seen of the object, None where nothing is."""
        v, u = np.nonzero(self.mask())
        return (float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1)) if len(v) else None

    def mask(self) -> NDArray[np.bool_]:
        """Pixels (H, W) of the colour image that show the object."""
        model = self._world.model
        return self.mask_of(np.flatnonzero(model.geom_bodyid == model.body("object").id).tolist())

    def mask_of(self, geoms: list[int]) -> NDArray[np.bool_]:
        """Pixels (H, W) of the colour image that show one of the geoms."""
        self._renderer.update_scene(self._world.data, "colour", self._options)
        self._renderer.enable_segmentation_rendering()
        seen = self._renderer.render()
        self._renderer.disable_segmentation_rendering()
        return np.asarray((seen[:, :, 1] == int(mujoco.mjtObj.mjOBJ_GEOM)) & np.isin(seen[:, :, 0], geoms))
