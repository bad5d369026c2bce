"""Looks of surfaces: images made from the object's name alone, detailed enough for a tracker."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Literal

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from dgeval.determinism import generator

SIZE = 256  # px of each of a texture's six faces


@dataclass(frozen=True, slots=True)
class Look:
    """Style and main colour (RGB 0..255)."""

    style: Literal["print", "mottled", "seam", "tiles"]
    colour: tuple[int, int, int]


def face(name: str, look: Look, side: int) -> NDArray[np.uint8]:
    """Image (SIZE, SIZE, 3) RGB of one side of an object."""
    rng = generator(0, f"texture/{name}", side)
    colour = np.array(look.colour, dtype=float)
    image = np.empty((SIZE, SIZE, 3), np.uint8)
    image[:] = np.clip(colour + rng.uniform(-15, 15, 3), 0, 255)
    if look.style == "tiles":
        sticker = [
            (220, 30, 30),
            (40, 90, 200),
            (245, 245, 240),
            (250, 210, 40),
            (30, 150, 70),
            (240, 120, 30),
        ]
        step = SIZE // 3
        for row in range(3):
            for column in range(3):
                a, b = (
                    (column * step + 7, row * step + 7),
                    ((column + 1) * step - 5, (row + 1) * step - 5),
                )
                cv2.rectangle(image, a, b, sticker[int(rng.integers(6))], -1)
    elif look.style == "seam":
        for x in (70, 186):
            for y in range(0, SIZE, 14):
                cv2.line(image, (x - 9, y), (x, y + 6), (180, 30, 30), 3)
                cv2.line(image, (x + 9, y), (x, y + 6), (180, 30, 30), 3)
    elif look.style == "print":
        for _ in range(9):
            x, y, w, h = (
                int(v) for v in (*rng.integers(0, SIZE - 30, 2), *rng.integers(18, 110, 2))
            )
            cv2.rectangle(
                image, (x, y), (x + w, y + h), [int(v) for v in rng.integers(0, 256, 3)], -1
            )
        for _ in range(7):
            at = (int(rng.integers(0, SIZE // 2)), int(rng.integers(20, SIZE)))
            letters = "".join(chr(int(c)) for c in rng.integers(65, 91, 6))
            ink = [int(v) for v in rng.choice([15, 245], 1).repeat(3)]
            cv2.putText(
                image, letters, at, cv2.FONT_HERSHEY_SIMPLEX, float(rng.uniform(0.7, 1.5)), ink, 3
            )
    speckle = cv2.GaussianBlur(
        rng.normal(0, 60 if look.style == "mottled" else 25, (SIZE, SIZE)), (0, 0), 2.0
    )
    return np.asarray(
        np.clip(image + speckle[:, :, None] * (2.5 if look.style == "mottled" else 1.5), 0, 255),
        dtype=np.uint8,
    )


@lru_cache(maxsize=8)
def _faces(name: str, look: Look) -> bytes:
    return np.concatenate([face(name, look, side) for side in range(6)]).tobytes()


def add_material(spec: mujoco.MjSpec, name: str, look: Look) -> str:
    """A material whose cube texture wraps any shape without coordinates of its own."""
    texture = spec.add_texture(
        name=f"look_{name}",
        type=mujoco.mjtTexture.mjTEXTURE_CUBE,
        width=SIZE,
        height=6 * SIZE,
        nchannel=3,
    )
    texture.data = _faces(name, look)
    material = spec.add_material(name=f"look_{name}", specular=0.1, shininess=0.1)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    return str(material.name)


@cache
def _ground(name: str, colour: tuple[int, int, int]) -> bytes:
    """The speckled picture, which every draw of a twin needs again."""
    rng = generator(0, f"texture/{name}", 0)
    # faint: the belt's texture does not move with the belt
    grain = cv2.GaussianBlur(rng.normal(0, 20, (512, 512)), (0, 0), 1.5)
    image = np.clip(np.array(colour, dtype=float) + grain[:, :, None], 0, 255)
    return bytes(image.astype(np.uint8).tobytes())


def add_ground(spec: mujoco.MjSpec, name: str, colour: tuple[int, int, int]) -> str:
    """A speckled material for belt and floor."""
    texture = spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=512, height=512, nchannel=3
    )
    texture.data = _ground(name, colour)
    material = spec.add_material(name=name, specular=0.0, texrepeat=[3, 3])
    material.texuniform = True
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    return name
