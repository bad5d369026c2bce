"""What is known of the target, carried to the time of control: one rule for replay and simulator.

An image's result is older than the control period that uses it, by the perception's latency; under
loss it is a prediction. In both the target goes on with its estimated velocity, and with it the
grasps (paper III-B.4). Where the estimate's policy under loss is that the target stands still, its
velocity is 0 (IV-B).
"""

from __future__ import annotations

from dataclasses import dataclass

from dgeval.geometry import Array


@dataclass(frozen=True, slots=True)
class Belief:
    """The target as of one image.

    t_ns: of the image. T_base_object (4, 4): of the target's own frame, in replay that of the model
    Q_t. velocity (3,) m/s, base frame. seen: from an accepted frame; else predicted.
    """

    t_ns: int
    T_base_object: Array
    velocity: Array
    seen: bool

    def at(self, t_ns: int) -> Array:
        """T_base_object (4, 4) at a time: carried there by the velocity."""
        T = self.T_base_object.copy()
        T[:3, 3] += self.velocity * ((t_ns - self.t_ns) * 1e-9)
        return T
