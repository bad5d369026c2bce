"""The faults injected into a trial.

Every fault is drawn, recorded, and can be taken out again to prove a cause.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace

import numpy as np

# translation m and rotation vector rad; a vector in m/s; both without a fault
Six = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]
NONE6: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NONE3: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Faults:
    """The faults of a trial. Zero means none. Sixes are translation m and rotation vector rad.

    hand_eye: true camera pose in the believed one. registration_bias: believed object pose in the
    true one. tracker_drift: velocity at which the believed position drifts, m/s, base.
    velocity_bias: added to the estimated velocity, m/s, base. latency: age of the perception beyond
    what the controller assumes, s.

    grasp_offset: chosen palm pose in the intended one. evaluator_bias: added to the score.
    close_shift: how much the close comes too early (negative) or too late (positive), s. descent:
    how much faster the hand comes down than it moves sideways (1: twice as fast), so that it sweeps
    in low.
    """

    hand_eye: Six = NONE6
    registration_bias: Six = NONE6
    velocity_bias: Three = NONE3
    latency: float = 0.0
    grasp_offset: Six = NONE6
    evaluator_bias: float = 0.0
    close_shift: float = 0.0
    tracker_drift: Three = NONE3
    descent: float = 0.0

    def present(self) -> tuple[str, ...]:
        """Names of the faults that are not zero."""
        return tuple(f.name for f in fields(self) if np.any(np.asarray(getattr(self, f.name)) != 0))

    def without(self, name: str) -> Faults:
        """The faults without one of them."""
        return replace(self, **{name: getattr(Faults(), name)})

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


def draw(rng: np.random.Generator, name: str, size: tuple[float, ...]) -> Six | Three | float:
    """One fault's value of a random direction and of 0.6 to 1.4 times a size.

    size: (m, degrees), (m/s,), (s,) or (1,), by the fault's name.
    """
    strength = rng.uniform(0.6, 1.4)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    if name in ("hand_eye", "registration_bias", "grasp_offset"):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        values = np.concatenate(
            [direction * strength * size[0], axis * strength * np.radians(size[1])]
        )
        return tuple(float(v) for v in values)  # type: ignore[return-value]
    if name in ("velocity_bias", "tracker_drift"):
        direction[2] *= 0.3  # belts don't rise; errors in height are smaller
        return tuple(float(v) for v in direction * strength * size[0])  # type: ignore[return-value]
    if name in ("latency", "descent"):
        return float(strength * size[0])
    return float(strength * size[0] * (1 if rng.random() < 0.5 else -1))
