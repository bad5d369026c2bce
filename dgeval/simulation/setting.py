"""What surrounds a trial's object: other objects, a turntable, a presenter."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from dgeval.worlds.objects import ObjectModel
from dgeval.worlds.presenter import Presenter

RAMP_S = 0.3  # s in which a belt comes up to speed; ours


@dataclass(frozen=True)
class Turn:
    """A turntable's motion: at rest, then turning, then at rest again.

    It turns from time `start`, s, at `speed`, rad/s (signed), through `angle`, rad (> 0).
    """

    start: float
    speed: float
    angle: float

    @property
    def end(self) -> float:
        return self.start + self.angle / abs(self.speed)

    def speed_at(self, t: float) -> float:
        return self.speed if self.start <= t < self.end else 0.0


@dataclass(frozen=True)
class LateBelt:
    """A belt that starts after the robot, as in the paper's Figure 4: speed m/s, from start s on.

    It takes RAMP_S to come up to speed: tall things would topple at once.
    """

    speed: float
    start: float

    def speed_at(self, t: float) -> float:
        return self.speed * float(np.clip((t - self.start) / RAMP_S, 0.0, 1.0))


@dataclass(frozen=True)
class Setting:
    """What surrounds the object beside its belt.

    others: objects with x, y m and yaw rad. presenter: a person who hands the object over. turn: a
    turntable. belt: None for one that runs from the start.
    """

    others: tuple[tuple[ObjectModel, float, float, float], ...] = ()
    presenter: Presenter | None = None
    turn: Turn | None = None
    belt: LateBelt | None = None

    def put(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Put the other objects where they stand at the start."""
        for k, (other, x, y, yaw) in enumerate(self.others):
            at = int(model.joint(f"other_{k}").qposadr[0])
            data.qpos[at : at + 7] = [
                x,
                y,
                other.rest_height(),
                np.cos(yaw / 2),
                0,
                0,
                np.sin(yaw / 2),
            ]

    def drive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Set presenter, turntable and belt for the data's time; called before each step."""
        if self.presenter is not None:
            present(self.presenter, data)
        if self.turn is not None:
            data.ctrl[model.actuator("turntable").id] = self.turn.speed_at(float(data.time))
        if self.belt is not None:
            model.geom_surfacevel[model.geom("belt").id][1] = self.belt.speed_at(float(data.time))


def present(presenter: Presenter, data: mujoco.MjData) -> None:
    """Move the presenter's hand to its pose at the data's time."""
    data.mocap_pos[0], data.mocap_quat[0] = presenter.pose(float(data.time))
