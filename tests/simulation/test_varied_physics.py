"""A trial's own physics.

Catches: a world that is recorded as drawn and simulated as modelled, a draw that depends on another
trial, and a scenario without such a section that is changed by it.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from dgeval.determinism import generator
from dgeval.simulation.campaign import Campaign, plan_of, world_of
from dgeval.simulation.physics import AS_MODELLED, Physics, PhysicsConfig, draw_physics
from dgeval.simulation.scenario import load_scenario


def campaign(physics: PhysicsConfig | None) -> Campaign:
    scenario = load_scenario("failures").model_copy(update={"physics": physics})
    return Campaign(scenario, 3, 4, Path("unused"))


def test_what_is_drawn_is_what_is_simulated() -> None:
    plain, varied = campaign(None), campaign(PhysicsConfig(other_solver=1.0))
    plan = plan_of(varied, 1)
    assert plan_of(plain, 1).physics == AS_MODELLED
    assert plan.physics != AS_MODELLED
    before, after = world_of(plain, plan_of(plain, 1)), world_of(varied, plan)
    a, b, drawn = before.model, after.model, plan.physics
    body = a.body("object").id
    assert b.body_mass[body] == pytest.approx(a.body_mass[body] * drawn.mass)
    assert b.body_inertia[body] == pytest.approx(a.body_inertia[body] * drawn.mass)
    for g in [*before.object_geoms, *before.hand_geoms]:
        assert b.geom_friction[g, 0] == pytest.approx(a.geom_friction[g, 0] * drawn.friction)
        assert b.geom_solref[g, 0] == pytest.approx(a.geom_solref[g, 0] * drawn.softness)
    capsule = next(g for g in before.hand_geoms if a.geom_type[g] == mujoco.mjtGeom.mjGEOM_CAPSULE)
    assert b.geom_size[capsule, 0] == pytest.approx(a.geom_size[capsule, 0] + drawn.radius)
    assert b.geom_rbound[capsule] >= b.geom_size[capsule, 0] + b.geom_size[capsule, 1] - 1e-12
    assert b.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    # all else is drawn as without
    assert plan_of(plain, 1).faults == plan.faults


def test_as_modelled_changes_nothing() -> None:
    plain = campaign(None)
    world = world_of(plain, plan_of(plain, 0))
    before = world.model.geom_friction.copy(), world.model.body_mass.copy()
    AS_MODELLED.put(world)
    np.testing.assert_array_equal(world.model.geom_friction, before[0])
    np.testing.assert_array_equal(world.model.body_mass, before[1])


def test_draws_are_as_wide_as_they_say() -> None:
    config = PhysicsConfig()
    drawn = [draw_physics(config, generator(0, "physics", k)) for k in range(600)]
    assert draw_physics(config, generator(0, "physics", 7)) == drawn[7]
    for name, sd in (("friction", 0.25), ("mass", 0.25), ("softness", 0.4)):
        logs = np.log([getattr(d, name) for d in drawn])
        assert abs(logs.mean()) < 0.2 * sd
        assert logs.std() == pytest.approx(sd, rel=0.15)
    assert np.std([d.radius for d in drawn]) == pytest.approx(0.001, rel=0.15)
    assert np.mean([d.other_solver for d in drawn]) == pytest.approx(0.25, abs=0.06)
    nothing = PhysicsConfig(friction=0, mass=0, softness=0, radius=0, other_solver=0)
    assert draw_physics(nothing, generator(0, "physics", 0)) == Physics()
