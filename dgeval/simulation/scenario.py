"""Scenarios: what a trial is drawn from. A trial is fully determined by (scenario, seed, index)."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from dgeval.config import Config, read_toml, validated
from dgeval.determinism import generator
from dgeval.errors import Place, UsageError
from dgeval.robots.hand import SimulatedHand, hand_named
from dgeval.simulation.faults import Faults, draw
from dgeval.simulation.imported_hand import read_hand
from dgeval.simulation.physics import AS_MODELLED, Physics, PhysicsConfig
from dgeval.simulation.setting import Turn
from dgeval.worlds.objects import ObjectModel
from dgeval.worlds.presenter import Presenter, draw_presenter
from dgeval.worlds.scene import TURNTABLE_CENTRE

PACKAGE = resources.files("dgeval.simulation")


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CameraConfig(_Section):
    profile: str = "D435"
    width: int = Field(640, ge=64, le=1920)
    height: int = Field(480, ge=48, le=1080)
    rate: float = Field(30.0, gt=0, le=90)
    min_range: float | None = Field(None, gt=0, description="m, in place of the profile's")
    jpeg_quality: int = Field(85, ge=1, le=100)
    drop: float = Field(0.01, ge=0, lt=1, description="share of frames that are lost")


class FaultConfig(_Section):
    share: float = Field(ge=0, le=1)
    size: tuple[float, ...]


class PerceptionNoise(_Section):
    """Noise of the modelled perception, per accepted frame; as replay shows on simulated
    recordings.
    """

    position: float = Field(0.001, ge=0, description="m, each axis")
    angle: float = Field(0.6, ge=0, description="degrees, each axis")


class EvaluatorConfig(_Section):
    """The score that stands in for FFHNet's evaluator.

    It is (0.5 + 0.5 quality) exp(-d^2/2s_t^2 - a^2/2s_r^2), with the palm's distance d and angle a
    from the grasp.
    """

    position: float = Field(0.009, gt=0, description="s_t, m")
    angle: float = Field(8.0, gt=0, description="s_r, degrees")


class PresenterConfig(_Section):
    """A person hands the object over in place of a belt; standard deviations of the tremor."""

    tremor_m: float = Field(0.003, ge=0, description="m, each axis")
    tremor_deg: float = Field(1.5, ge=0, description="degrees, each axis")


class TableConfig(_Section):
    """Several objects on the table (VFAS-Grasp IV-A).

    Each arrangement holds half of the objects in turn.
    """

    arrangements: int = Field(10, ge=1)
    objects: int = Field(4, ge=1, le=4, description="in an arrangement")


class TurntableConfig(_Section):
    """The object stands on a disc that turns (VFAS-Grasp IV-B).

    Each radius is one nominal speed.
    """

    radii: tuple[float, ...] = Field(
        (0.06, 0.10, 0.14), description="m of the object from the axis"
    )
    rate: float = Field(2 * np.pi / 10, gt=0, description="rad/s")
    angle: tuple[float, float] = Field((60.0, 120.0), description="degrees, least and most")
    start: float = Field(0.5, ge=0, description="s")


class SeedConfig(_Section):
    """The seed grasp: one that is known to hold, with an error as of another planner."""

    position: float = Field(
        0.015,
        ge=0,
        description="m, each axis, 1 sigma; seeds alone then hold as often as the paper's",
    )
    angle: float = Field(6.0, ge=0, description="degrees, each axis, 1 sigma")


class Scenario(_Section):
    name: str
    table: TableConfig | None = None
    turntable: TurntableConfig | None = None
    seed_error: SeedConfig = SeedConfig()
    presenter: PresenterConfig | None = Field(
        None, description="the object is handed over; default: a belt"
    )
    objects: tuple[str, ...] | None = Field(
        None, description="default: all ten, or those of --meshes"
    )
    speeds: tuple[float, ...] = (0.0,)
    belt_start_s: float = Field(
        0.0, ge=0, description="s after the robot's start, at which the belt starts; 0: it runs"
    )
    trials: int = Field(10, ge=1)
    choose: dict[Literal["success", "imprecise_pose", "collision", "timing"], int] | None = Field(
        None, description="how many of each kind to record, the first in order; default: all trials"
    )
    max_attempts: int = Field(
        20, ge=1, description="simulate at most this many times `trials` while choosing"
    )
    depth_level: int = Field(4, ge=0, le=9, description="PNG compression of depth")
    perception: Literal["modelled", "rendered"] = Field(
        "modelled",
        description="in the loop: truth with errors, "
        "or the pipeline's own stages on rendered images",
    )
    hand: str | None = Field(
        None, description="a hand's .urdf or .toml file, in place of the scenario's own hand"
    )
    grasps: Literal["ffhnet", "analytic"] = Field(
        "ffhnet",
        description="in the loop: the shipped FFHNet on the model cloud, "
        "or known grasps with an analytic score",
    )
    plans_of: str | None = Field(
        None, description="draw the same trials as the scenario of that name"
    )
    max_seconds: float = Field(7.0, gt=1, description="without a close, the trial ends")
    camera: CameraConfig = CameraConfig()
    noise: PerceptionNoise = PerceptionNoise()
    evaluator: EvaluatorConfig = EvaluatorConfig()
    physics: PhysicsConfig | None = Field(
        None, description="each trial in a world of its own; default: the same physics in all"
    )
    faults: dict[str, FaultConfig] = {}
    faults_at_most: int | None = Field(
        None,
        ge=1,
        description="draw 1 to this many faults with the shares as weights; "
        "default: each by its own share",
    )
    pipeline: Config = Config()

    @property
    def vfas(self) -> bool:
        """Whether VFAS-Grasp's system is simulated: its planner, gripper and objects."""
        return self.pipeline.pipeline == "vfas"

    @property
    def gripper(self) -> SimulatedHand:
        if self.hand is not None:
            return read_hand(Path(self.hand))
        return hand_named("parallel_jaw" if self.vfas else "dlr_hit_hand")


@dataclass(frozen=True)
class Plan:
    """One trial as drawn.

    speed: of the belt, m/s along +y with sign. x, y m and yaw rad: the object's start. home_y m: y
    of the hand at the start. others: name, x, y, yaw of each other object on the table.
    close_jitter s: added to the close time. physics: of the trial's world.
    """

    id: str
    object: str
    speed: float
    x: float
    y: float
    yaw: float
    home_y: float
    faults: Faults
    seed: int
    index: int
    close_jitter: float = 0.0
    presenter: Presenter | None = None
    others: tuple[tuple[str, float, float, float], ...] = ()
    turn: Turn | None = None
    physics: Physics = AS_MODELLED

    @property
    def nominal_speed(self) -> float:
        """Speed of the object, m/s: of its belt, with sign, or of its place on a turning disc."""
        if self.turn is None:
            return self.speed
        radius = np.hypot(self.x - TURNTABLE_CENTRE[0], self.y - TURNTABLE_CENTRE[1])
        return round(float(radius * abs(self.turn.speed)), 4)


def load_scenario(name: str) -> Scenario:
    """A built-in scenario by name, or a TOML file. UsageError names the fault."""
    built_in = sorted(
        p.name[:-5] for p in (PACKAGE / "scenarios").iterdir() if p.name.endswith(".toml")
    )
    if name.endswith(".toml"):
        path = Path(name)
    elif name in built_in:
        path = Path(str(PACKAGE / "scenarios" / f"{name}.toml"))
    else:
        near = difflib.get_close_matches(name, built_in, n=1)
        hint = (
            f"did you mean {near[0]}?"
            if near
            else f"built in: {', '.join(built_in)}; or give a FILE.toml"
        )
        raise UsageError(f"no scenario {name!r}", hint=hint)
    values: dict[str, Any] = read_toml(path)
    scenario = validated(Scenario, values, "scenario", path)
    unknown = sorted(set(scenario.faults) - set(Faults.__dataclass_fields__))
    if unknown:
        known = ", ".join(Faults.__dataclass_fields__)
        raise UsageError(f"scenario: no fault {unknown[0]!r}", Place(str(path)), f"known: {known}")
    if scenario.hand is not None:
        return with_hand(scenario, path.parent / scenario.hand)
    return scenario


@dataclass(frozen=True)
class MadeFrom:
    """What a manifest's recordings were simulated from.

    sha256: of the recordings by trial, on the platform that it names. hand_sha256: of the user's
    hand that they were made with.
    """

    scenario: str
    seed: int
    indices: tuple[int, ...]
    platform: str
    sha256: dict[str, str]
    hand_sha256: str | None = None


def load_manifest(path: Path) -> MadeFrom | None:
    """The `[simulate]` part of a manifest; None of a file without one (a scenario)."""
    values = read_toml(path)
    section = values.get("simulate")
    if not isinstance(section, dict):
        return None
    try:
        hashes = {str(t["id"]): str(t["sha256"]) for t in values.get("trial", []) if "sha256" in t}
        name, indices = str(section["scenario"]), tuple(int(i) for i in section["indices"])
        platform, hand = str(section["platform"]), section.get("hand_sha256")
        return MadeFrom(name, int(section["seed"]), indices, platform, hashes, hand)
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(
            f"manifest: [simulate] is not complete ({error})", Place(str(path))
        ) from error


def with_hand(scenario: Scenario, hand: Path) -> Scenario:
    """A scenario with a user's hand. Grasps are found for it in physics: no network knows it.

    UsageError for a scenario of the gripper that VFAS-Grasp's planner is for.
    """
    if scenario.vfas:
        raise UsageError(
            f"the scenario {scenario.name!r} is of VFAS-Grasp's own gripper",
            hint="a hand goes with conveyor, handover, failures, static",
        )
    return scenario.model_copy(update={"hand": str(hand), "grasps": "analytic"})


def plan_trial(scenario: Scenario, objects: dict[str, ObjectModel], seed: int, index: int) -> Plan:
    """Trial `index`: objects and speeds in turn, the rest drawn.

    Each object comes once at every speed.
    """
    names = scenario.objects or tuple(objects)
    missing = [n for n in names if n not in objects]
    if missing:
        raise UsageError(f"scenario: no object {missing[0]!r}", hint=f"known: {', '.join(objects)}")
    name = names[index % len(names)]
    speed = scenario.speeds[index // len(names) % len(scenario.speeds)]
    drawn_as = scenario.plans_of or scenario.name
    rng = generator(seed, f"plan/{drawn_as}", index)
    direction = 1.0 if rng.random() < 0.5 else -1.0
    yaw = float(rng.uniform(-3.14159, 3.14159))
    x = 0.47 + float(rng.uniform(-0.06, 0.06))
    y = -direction * min(0.42, 0.05 + 1.9 * speed) + float(rng.uniform(-0.02, 0.02))
    # the hand doesn't start right above the object
    home_y = min(max(y + float(rng.uniform(-0.09, 0.09)), -0.45), 0.45)
    wanted: list[str] | None = None
    if scenario.faults_at_most is not None and scenario.faults:
        weights = np.array([f.share for f in scenario.faults.values()])
        count = min(int(rng.integers(1, scenario.faults_at_most + 1)), int((weights > 0).sum()))
        wanted = [
            str(n)
            for n in rng.choice(
                list(scenario.faults), count, replace=False, p=weights / weights.sum()
            )
        ]
    values: dict[str, Any] = {}
    # each from its own draws, so that adding one changes no other
    for fault in Faults.__dataclass_fields__:
        own = generator(seed, f"plan/{drawn_as}/{fault}", index)
        config = scenario.faults.get(fault)
        drawn = own.random() < (config.share if config is not None else 0.0)
        if config is not None and (drawn if wanted is None else fault in wanted):
            values[fault] = draw(own, fault, config.size)
    trial_id = f"{name}-{round(speed * 1000):03d}-{index:04d}"
    presenter = None
    if (config_of := scenario.presenter) is not None:
        own = generator(seed, f"plan/{drawn_as}/presenter", index)
        presenter = draw_presenter(
            own,
            objects[name].extent(),
            x,
            y,
            yaw,
            config_of.tremor_m,
            np.radians(config_of.tremor_deg),
        )
    return Plan(
        trial_id,
        name,
        direction * speed,
        x,
        y,
        yaw,
        home_y,
        Faults(**values),
        seed,
        index,
        presenter=presenter,
    )
