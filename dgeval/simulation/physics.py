"""What a trial's world may differ in from the physics that a verdict assumes.

Real friction, masses, contacts and links are never those of a model. A scenario with a section
`physics` draws them anew for each trial, and nothing of it is recorded.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from dgeval.worlds.hand_and_object import HandAndObject

ROUND = (int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE))


class PhysicsConfig(BaseModel):
    """How far the world of a trial is drawn from that of the model; all ours.

    Household objects of one size have masses that differ by more than any of these.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    friction: float = Field(0.25, ge=0, le=1, description="1 sigma of its logarithm, hand, object")
    mass: float = Field(0.25, ge=0, le=1, description="1 sigma of the object's logarithm")
    softness: float = Field(
        0.4, ge=0, le=1, description="1 sigma of the logarithm of contacts' time constant"
    )
    radius: float = Field(0.001, ge=0, le=0.005, description="m, 1 sigma, of links that are round")
    other_solver: float = Field(
        0.25, ge=0, le=1, description="share of trials with a pyramidal cone and 20 iterations"
    )


@dataclass(frozen=True)
class Physics:
    """Factors of friction, of the object's mass and of contacts' time constant; m added to the
    radius of round links; whether another solver is used. The defaults change nothing.
    """

    friction: float = 1.0
    mass: float = 1.0
    softness: float = 1.0
    radius: float = 0.0
    other_solver: bool = False

    def put(self, world: HandAndObject) -> None:
        """Change a compiled world."""
        if self == AS_MODELLED:
            return
        m = world.model
        for g in world.object_geoms + world.hand_geoms:
            m.geom_friction[g, 0] *= self.friction
            m.geom_solref[g, 0] *= self.softness
        for g in world.hand_geoms:
            if int(m.geom_type[g]) in ROUND:
                m.geom_size[g, 0] = max(m.geom_size[g, 0] + self.radius, m.geom_size[g, 0] / 2)
                m.geom_rbound[g] += max(self.radius, 0.0)
        body = m.body("object").id
        m.body_mass[body] *= self.mass
        m.body_inertia[body] *= self.mass
        mujoco.mj_setConst(m, world.data)
        if self.other_solver:
            m.opt.cone, m.opt.impratio, m.opt.iterations = (
                mujoco.mjtCone.mjCONE_PYRAMIDAL,
                1.0,
                20,
            )


AS_MODELLED = Physics()


def draw_physics(config: PhysicsConfig, rng: np.random.Generator) -> Physics:
    """The world of one trial."""
    friction, mass, softness = np.exp(
        rng.normal(0.0, [config.friction, config.mass, config.softness])
    )
    radius = float(rng.normal(0.0, config.radius))
    other = bool(rng.random() < config.other_solver)
    return Physics(float(friction), float(mass), float(softness), radius, other)
