"""A person who hands an object over: the motion, a drawn hand, and a grip that lets go."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array
from dgeval.robots.mjcf import quat_wxyz

# All values here are ours.
GRIP = "presenter_grip"  # name of the weld that holds the object
# The presenter lets go when two fingers have pressed with GRIPPED_N (N) for RELEASE_S (s).
GRIPPED_N, RELEASE_S = 0.3, 0.1
# Hz, of the tremor in each degree of freedom; amplitudes fall with the frequency.
TREMOR_HZ = (0.6, 1.1, 1.9, 2.7)
SKIN = (0.80, 0.62, 0.52, 1.0)  # RGBA, 0 to 1, of the drawn hand


@dataclass(frozen=True)
class Presenter:
    """Motion of the object in a person's hand.

    It moves from `start` to `end` (3,) m in `arrive` s and slows down smoothly. Then it is held and
    trembles, turned by `yaw` rad about z. phases (6, 4) rad: of the tremor of three translations
    and three rotations. tremor_m, tremor_rad: standard deviation of the tremor on each axis.
    """

    start: Array
    end: Array
    arrive: float
    yaw: float
    phases: Array
    tremor_m: float
    tremor_rad: float

    def pose(self, t: float) -> tuple[Array, Array]:
        """Position (3,) m and quaternion wxyz of the undisturbed object's frame at time t, s."""
        s = float(np.clip(t / self.arrive, 0.0, 1.0))
        progress = s**3 * (10 - 15 * s + 6 * s * s)  # minimum jerk
        weights = 1 / np.array(TREMOR_HZ)
        waves = (
            np.sin(2 * np.pi * np.array(TREMOR_HZ) * t + self.phases)
            @ weights
            * np.sqrt(2 / (weights**2).sum())
        )
        turn = Rotation.from_rotvec(self.tremor_rad * waves[3:]) * Rotation.from_euler(
            "z", self.yaw
        )
        return self.start + progress * (self.end - self.start) + self.tremor_m * waves[
            :3
        ], quat_wxyz(turn.as_matrix())


def draw_presenter(
    rng: np.random.Generator,
    extent: Array,
    x: float,
    y: float,
    yaw: float,
    tremor_m: float,
    tremor_rad: float,
) -> Presenter:
    """A random handover to about (x, y) m over the table, from 0.25 to 0.4 m away.

    extent (3,) m: the object's size. yaw in rad. tremor_m, tremor_rad: standard deviations.
    """
    top = rng.uniform(0.20, 0.26)
    end = np.array([x, y, max(top - extent[2] / 2, 0.04 + extent[2] / 2)])
    heading, far = rng.uniform(-0.5, 0.5) * np.pi, rng.uniform(0.25, 0.40)
    start = (
        end
        + far * np.array([0.6 * np.cos(heading), np.sin(heading), 0.0])
        + [0.0, 0.0, rng.uniform(-0.03, 0.03)]
    )
    speed = rng.uniform(0.12, 0.25)  # m/s, mean
    return Presenter(
        start,
        end,
        float(np.linalg.norm(end - start)) / speed,
        yaw,
        rng.uniform(0, 2 * np.pi, (6, 4)),
        tremor_m,
        tremor_rad,
    )


def add_presenter(spec: mujoco.MjSpec, extent: Array) -> None:
    """A mocap body that holds `object` by a soft weld (docs/simulation.md, "Presenter").

    extent (3,) m: the object's size. Drawn fingers lie round its lower half; they have no contact.
    """
    body = spec.worldbody.add_body(name="presenter", mocap=True)
    half = extent / 2
    palm_z = -half[2] - 0.014
    reach = min(0.05, max(0.02, half[2]))
    middle = palm_z + reach / 2 + 0.012
    box, capsule = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
    upright, lying = [1.0, 0, 0, 0], [0.7071, 0, 0.7071, 0]
    # kind, size m, position m, quaternion: palm, thumb, forearm, four fingers opposite to the thumb
    solids = [
        (box, [0.030, 0.042, 0.013], [0.0, 0.0, palm_z], upright),
        (capsule, [0.010, reach / 2, 0], [-half[0] - 0.012, 0.0, middle], upright),
        (capsule, [0.030, 0.10, 0], [0.14, 0.0, palm_z - 0.03], lying),
        *(
            (capsule, [0.008, reach / 2, 0], [half[0] + 0.010, y, middle], upright)
            for y in (-0.03, -0.01, 0.01, 0.03)
        ),
    ]
    for kind, size, pos, quat in solids:
        body.add_geom(type=kind, size=size, pos=pos, quat=quat, contype=0, conaffinity=0, rgba=SKIN)
    weld = spec.add_equality(
        name=GRIP,
        type=mujoco.mjtEq.mjEQ_WELD,
        name1="presenter",
        name2="object",
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        solref=[0.05, 1],  # s, damping ratio
    )
    data = np.zeros(len(weld.data))
    data[6], data[10] = 1.0, 0.1  # identity relative rotation, torque scale
    weld.data = data
