"""Trials of VFAS-Grasp's three experiments as drawn."""

from __future__ import annotations

import numpy as np

from dgeval.determinism import generator
from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.simulation.faults import Faults
from dgeval.simulation.scenario import Plan, Scenario
from dgeval.simulation.setting import Turn
from dgeval.worlds.objects import ObjectModel
from dgeval.worlds.presenter import Presenter, draw_presenter
from dgeval.worlds.scene import TURNTABLE_CENTRE

# m: ranges in which objects stand, and the least free distance between them; ours
PLACES_X, PLACES_Y, GAP = (0.36, 0.60), (-0.26, 0.26), 0.025
HANDOVER_START = np.array([0.36, 0.0, 0.42])  # m, where the gripper waits; ours
HANDOVER_PITCH = np.radians(140.0)  # rad, of its approach: it looks 50 degrees down; ours


def plan_vfas(scenario: Scenario, objects: dict[str, ObjectModel], seed: int, index: int) -> Plan:
    """Trial `index`.

    Table: arrangements, and in each of them every object once as the target. Else objects and radii
    in turn.
    """
    rng = generator(seed, f"plan/{scenario.name}", index)
    names = scenario.objects or tuple(objects)
    missing = [n for n in names if n not in objects]
    if missing:
        raise UsageError(f"scenario: no object {missing[0]!r}", hint=f"known: {', '.join(objects)}")
    yaw = float(rng.uniform(-np.pi, np.pi))
    if scenario.table is not None:
        count = scenario.table.objects
        arrangement, target = index // count % scenario.table.arrangements, index % count
        chosen = [names[(arrangement % 2 * count + k) % len(names)] for k in range(count)]
        places = arranged(
            [objects[n] for n in chosen],
            generator(seed, f"arrangement/{scenario.name}", arrangement),
        )
        others = tuple(
            (n, *p) for k, (n, p) in enumerate(zip(chosen, places, strict=True)) if k != target
        )
        x, y, yaw = places[target]
        name = chosen[target]
        return Plan(
            f"{name}-{arrangement:02d}-{index:04d}",
            name,
            0.0,
            x,
            y,
            yaw,
            0.0,
            Faults(),
            seed,
            index,
            others=others,
        )
    name = names[index % len(names)]
    if scenario.turntable is not None:
        t = scenario.turntable
        radius = t.radii[index // len(names) % len(t.radii)]
        place = rng.uniform(-np.pi, np.pi)
        sign = 1.0 if rng.random() < 0.5 else -1.0
        turn = Turn(t.start, sign * t.rate, float(np.radians(rng.uniform(*t.angle))))
        x, y = (
            TURNTABLE_CENTRE[0] + radius * np.cos(place),
            TURNTABLE_CENTRE[1] + radius * np.sin(place),
        )
        trial = f"{name}-{round(radius * t.rate * 1000):03d}-{index:04d}"
        return Plan(
            trial, name, 0.0, float(x), float(y), yaw, 0.0, Faults(), seed, index, turn=turn
        )
    if scenario.presenter is None:
        raise UsageError(
            f"scenario {scenario.name!r}: no table, turntable or presenter",
            hint="the pipeline vfas needs one",
        )
    presenter = _presented(scenario, objects[name], rng, yaw)
    return Plan(
        f"{name}-{index:04d}",
        name,
        0.0,
        0.0,
        0.0,
        yaw,
        0.0,
        Faults(),
        seed,
        index,
        presenter=presenter,
    )


def arranged(
    objects: list[ObjectModel], rng: np.random.Generator
) -> list[tuple[float, float, float]]:
    """x, y m and yaw rad of upright objects that stand clear of each other.

    UsageError where they don't fit.
    """
    reach = [float(np.linalg.norm(t.extent()[:2])) / 2 for t in objects]
    for _ in range(2000):
        xy = np.column_stack(
            [rng.uniform(*PLACES_X, len(objects)), rng.uniform(*PLACES_Y, len(objects))]
        )
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=2) - np.add.outer(reach, reach)
        if (apart[np.triu_indices(len(objects), 1)] > GAP).all():
            yaws = rng.uniform(-np.pi, np.pi, len(objects))
            return [(float(x), float(y), float(a)) for (x, y), a in zip(xy, yaws, strict=True)]
    raise UsageError("an arrangement's objects don't fit on the table", hint="fewer objects")


def waiting_pose() -> Array:
    """T_base_grasp (4, 4) of the gripper that waits for a handover.

    It looks forward and down, its jaws horizontal.
    """
    approach = np.array([np.sin(HANDOVER_PITCH), 0.0, np.cos(HANDOVER_PITCH)])
    closing = np.array([0.0, 1.0, 0.0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([closing, np.cross(approach, closing), approach])
    T[:3, 3] = HANDOVER_START
    return T


def _presented(
    scenario: Scenario, target: ObjectModel, rng: np.random.Generator, yaw: float
) -> Presenter:
    """A handover to where the gripper looks.

    The upper part of the object comes to the seed, within 3 cm on each axis.
    """
    assert scenario.presenter is not None
    c = scenario.presenter
    drawn = draw_presenter(
        rng, target.extent(), 0.0, 0.0, yaw, c.tremor_m, np.radians(c.tremor_deg)
    )
    T = waiting_pose()
    seed = T[:3, 3] + scenario.pipeline.vfas.search_ahead * T[:3, 2]
    end = seed + rng.uniform(-0.03, 0.03, 3) - [0.0, 0.0, target.extent()[2] / 2 - 0.02]
    start = end + drawn.start - drawn.end
    return Presenter(start, end, drawn.arrive, yaw, drawn.phases, drawn.tremor_m, drawn.tremor_rad)
