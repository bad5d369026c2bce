"""Many trials: simulated without images first, then those that are wanted are rendered.

Trials run over processes and can be resumed; the result is the same for any number of processes.
OUT/truth/<trial>.json is the commit mark of a simulated trial, OUT/recorded/<trial>.json that of
its recording. The manifest (OUT/<scenario>.toml) names all recordings and what they were made from.
OUT/simulated.json holds the truth of all trials, also of those not chosen.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import shutil
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from dgeval import __version__
from dgeval.determinism import fingerprint, generator, limit_threads, set_thread_variables
from dgeval.errors import UsageError
from dgeval.planning.grasps import networks_of
from dgeval.recording.containers.container import sha256_of
from dgeval.simulation.blame import blame
from dgeval.simulation.grasps import KnownGrasp, known_grasps
from dgeval.simulation.hand_grasps import kept_grasps
from dgeval.simulation.imported_hand import ImportedHand, read_hand
from dgeval.simulation.meshes import load_meshes
from dgeval.simulation.perception import ModelledPerception, depth_profile, true_cameras
from dgeval.simulation.physics import draw_physics
from dgeval.simulation.proposals import FFHNetGrasps, GraspSource, KnownGrasps
from dgeval.simulation.record import verdict_document, write_recording
from dgeval.simulation.render import Renderer
from dgeval.simulation.scenario import Plan, Scenario, plan_trial
from dgeval.simulation.seeing import Images, RenderedPerception
from dgeval.simulation.setting import LateBelt, Setting
from dgeval.simulation.trial import Run, run_trial
from dgeval.simulation.truth import prove
from dgeval.simulation.vfas_plan import plan_vfas
from dgeval.simulation.vfas_trial import run_vfas
from dgeval.simulation.world import World, twin_path
from dgeval.worlds.closing import AFTER_CLOSE_S, CONTROL_S
from dgeval.worlds.hand_and_object import UnstableError
from dgeval.worlds.objects import ObjectModel, eight_objects, ten_objects
from dgeval.worlds.scene import Camera

# Trials simulated between two checks of what is still wanted; ours. It is constant, so that the
# number of jobs does not matter.
BLOCK = 24


@dataclass(frozen=True)
class Campaign:
    """What to make.

    indices: of the trials; None: the first `trials` of the scenario, or as many as its choice
    needs. meshes: folder of users' meshes. blame: also find the fault to blame. images: also
    record. format: of the recordings, mcap, bag or db3. stranger: record as a robot does that has
    never heard of dgeval, into OUT/recordings. labels_only: no other closes of a success, and not
    which thresholds decide.
    """

    scenario: Scenario
    seed: int
    trials: int
    out: Path
    meshes: Path | None = None
    blame: bool = False
    indices: tuple[int, ...] | None = None
    images: bool = True
    format: str = "mcap"
    stranger: bool = False
    labels_only: bool = False

    @property
    def recordings(self) -> Path:
        """The folder of the recordings."""
        return self.out / "recordings" if self.stranger else self.out

    def _meshes_sha256(self) -> str | None:
        """SHA-256 of the meshes' content: a file changed in place makes other trials."""
        if self.meshes is None:
            return None
        files = sorted(p for p in self.meshes.iterdir() if p.is_file())
        return hashlib.sha256(
            b"".join(p.name.encode() + sha256_of(p).encode() for p in files)
        ).hexdigest()

    @property
    def records_all(self) -> bool:
        """Whether every simulated trial is recorded.

        Then none is chosen, and each is simulated once, in the world with the cameras.
        """
        chosen = self.indices is None and self.scenario.choose is not None
        return self.images and not chosen

    def key(self) -> str:
        """Hash of what a trial's result depends on; how many trials are wanted is not
        part of it.
        """
        scenario = self.scenario.model_dump(
            mode="json", exclude={"choose", "max_attempts", "trials", "hand"}
        )
        inputs = [
            __version__,
            scenario,
            self.seed,
            self.blame,
            self._meshes_sha256(),
            fingerprint(),
        ]
        if self.format != "mcap":
            inputs.append(self.format)
        if self.stranger:
            inputs.append("stranger")
        if self.labels_only:
            inputs.append("labels_only")
        if isinstance(hand := self.scenario.gripper, ImportedHand):
            inputs.append(hand.sha256)
        return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()


@cache
def _objects(meshes: Path | None, vfas: bool) -> dict[str, ObjectModel]:
    if meshes is not None:
        return load_meshes(meshes)
    return eight_objects() if vfas else ten_objects()


@cache
def _known(meshes: Path | None, name: str) -> list[KnownGrasp]:
    return known_grasps(_objects(meshes, False)[name])


@cache
def _known_of_hand(hand: Path, meshes: Path | None, name: str, folder: Path) -> list[KnownGrasp]:
    return kept_grasps(read_hand(hand), _objects(meshes, False)[name], folder)


def find_grasps(campaign: Campaign, index: int) -> dict[str, Any]:
    """Find the grasps of the scenario's own hand for one of its objects, and how many there are."""
    limit_threads()
    name = _names(campaign)[index]
    return {"id": name, "count": len(_grasps(campaign, name))}


def _names(campaign: Campaign) -> tuple[str, ...]:
    return campaign.scenario.objects or tuple(_objects(campaign.meshes, campaign.scenario.vfas))


def _grasps(campaign: Campaign, name: str) -> list[KnownGrasp]:
    hand = campaign.scenario.hand
    if hand is None:
        return _known(campaign.meshes, name)
    return _known_of_hand(Path(hand), campaign.meshes, name, campaign.out / "grasps")


def plan_of(campaign: Campaign, index: int) -> Plan:
    """Trial `index` as drawn."""
    objects = _objects(campaign.meshes, campaign.scenario.vfas)
    scenario = campaign.scenario
    planned = plan_vfas if scenario.vfas else plan_trial
    plan = planned(scenario, objects, campaign.seed, index)
    if scenario.physics is None:
        return plan
    rng = generator(campaign.seed, f"physics/{scenario.name}", index)
    return replace(plan, physics=draw_physics(scenario.physics, rng))


def world_of(campaign: Campaign, plan: Plan, cameras: tuple[Camera, ...] = ()) -> World:
    """The world a plan is carried out in, before its start."""
    objects = _objects(campaign.meshes, campaign.scenario.vfas)
    others = tuple((objects[name], x, y, yaw) for name, x, y, yaw in plan.others)
    late = campaign.scenario.belt_start_s
    belt = LateBelt(plan.speed, late) if late and plan.speed else None
    setting = Setting(others, plan.presenter, plan.turn, belt)
    gripper = campaign.scenario.gripper
    world = World(objects[plan.object], plan.speed, cameras, setting, gripper=gripper)
    plan.physics.put(world)
    return world


def grasps_of(campaign: Campaign, plan: Plan) -> GraspSource:
    """Where the scenario's grasps come from."""
    scenario = campaign.scenario
    if scenario.grasps == "analytic":
        return KnownGrasps(_grasps(campaign, plan.object), scenario.evaluator)
    return FFHNetGrasps(
        networks_of(scenario.pipeline.grasps), scenario.pipeline.grasps, plan.seed, plan.index
    )


def simulate(campaign: Campaign, plan: Plan) -> tuple[Run, World]:
    """One trial in closed loop; on modelled perception without images where the
    pipeline allows it.
    """
    if campaign.scenario.vfas:
        with with_images(campaign, plan) as (run, world, _, _):
            return run, world
    world = world_of(campaign, plan)
    perceiver = ModelledPerception(campaign.scenario, plan, world)
    return run_trial(plan, campaign.scenario, world, grasps_of(campaign, plan), perceiver), world


@contextmanager
def with_images(
    campaign: Campaign, plan: Plan
) -> Iterator[tuple[Run, World, Renderer, dict[int, Images]]]:
    """One trial in closed loop in a world with cameras.

    Yields the run, its world, the renderer, and the images that perception drew in the loop, by
    frame.
    """
    scenario = campaign.scenario
    cameras = true_cameras(scenario, plan)
    world = world_of(campaign, plan, cameras)
    with Renderer(world, cameras, depth_profile(scenario), plan.seed, plan.index) as renderer:
        if scenario.vfas:
            run, kept = run_vfas(plan, scenario, world, renderer)
            yield run, world, renderer, kept
            return
        perceiver: ModelledPerception | RenderedPerception = ModelledPerception(
            scenario, plan, world
        )
        kept = {}
        if scenario.perception == "rendered":
            perceiver = RenderedPerception(scenario, plan, renderer)
            kept = perceiver.kept
        run = run_trial(plan, scenario, world, grasps_of(campaign, plan), perceiver)
        yield run, world, renderer, kept


def prove_trial(campaign: Campaign, index: int) -> dict[str, Any]:
    """Simulate trial `index`, prove the truth about it and write its JSON; read back a finished
    one.
    """
    limit_threads()
    plan = plan_of(campaign, index)
    path = campaign.out / "truth" / f"{plan.id}.json"
    done = _finished(path, campaign.key())
    if done is not None:
        return done
    try:
        out = _proved(campaign, plan)
    except UnstableError:  # nothing is known of it, and it is not recorded
        verdict = {"outcome": "unknown", "failure_class": None, "unstable": True}
        out = {"id": plan.id, "key": campaign.key(), "index": plan.index, "verdict": verdict}
    _write(path, out)
    return out


def _proved(campaign: Campaign, plan: Plan) -> dict[str, Any]:
    start = time.perf_counter()
    if campaign.scenario.vfas or campaign.scenario.perception == "rendered" or campaign.records_all:
        with with_images(campaign, plan) as (run, world, renderer, kept):
            physics = time.perf_counter() - start
            out = _prove(campaign, plan, run, world, physics)
            if campaign.images:
                _record(campaign, plan, run, world, out["verdict"], renderer, kept)
    else:
        run, world = simulate(campaign, plan)
        out = _prove(campaign, plan, run, world, time.perf_counter() - start)
    return out


def _prove(
    campaign: Campaign, plan: Plan, run: Run, world: World, physics: float
) -> dict[str, Any]:
    seconds = {"physics": physics}
    start = time.perf_counter()
    truth = prove(run, world, labels_only=campaign.labels_only)
    seconds["truth"] = time.perf_counter() - start
    blamed = None
    if campaign.blame and truth.outcome == "failure":
        start = time.perf_counter()
        blamed = blame(plan, lambda p: _succeeds(campaign, p))
        seconds["blame"] = time.perf_counter() - start
    return {
        "id": plan.id,
        "key": campaign.key(),
        "index": plan.index,
        "verdict": verdict_document(run, truth, blamed, campaign.scenario),
        "physics_sha256": _physics_hash(run),
        "seconds": seconds,
    }


def recording_name(campaign: Campaign, trial: str) -> str:
    """File, or folder for db3, of a trial's recording."""
    return trial if campaign.format == "db3" else f"{trial}.{campaign.format}"


def _succeeds(campaign: Campaign, plan: Plan) -> bool:
    finish = simulate(campaign, plan)[0].finish
    return finish is not None and finish.success


def record_trial(campaign: Campaign, index: int) -> dict[str, Any]:
    """Simulate trial `index` again with cameras and write its recording with the proved truth."""
    limit_threads()
    plan = plan_of(campaign, index)
    if (done := _recorded(campaign, plan)) is not None:
        return done
    proved = prove_trial(campaign, index)
    if (done := _recorded(campaign, plan)) is not None:  # it may have been recorded on the way
        return done
    with with_images(campaign, plan) as (run, world, renderer, kept):
        return _record(campaign, plan, run, world, proved["verdict"], renderer, kept)


def _recorded(campaign: Campaign, plan: Plan) -> dict[str, Any] | None:
    done = _finished(campaign.out / "recorded" / f"{plan.id}.json", campaign.key())
    return done if (campaign.recordings / recording_name(campaign, plan.id)).exists() else None


def _record(
    campaign: Campaign,
    plan: Plan,
    run: Run,
    world: World,
    verdict: dict[str, Any],
    renderer: Renderer,
    kept: dict[int, Images],
) -> dict[str, Any]:
    start = time.perf_counter()
    seconds = len(run.ticks) * CONTROL_S + AFTER_CLOSE_S
    twin = twin_path(world.target, plan.speed, plan.x, plan.y, plan.yaw, seconds, world.setting)
    file = campaign.recordings / recording_name(campaign, plan.id)
    part = campaign.out / "part" / file.name
    if part.is_dir():
        shutil.rmtree(part)
    part.parent.mkdir(exist_ok=True)
    recorded = write_recording(
        part, run, verdict, twin, campaign.scenario, world, renderer, kept, campaign.stranger
    )
    if file.is_dir():
        shutil.rmtree(file)
    part.rename(file)
    out = {
        "id": plan.id,
        "key": campaign.key(),
        "index": plan.index,
        "recording": file.name,
        "sha256": sha256_of(file),
        "bytes": sum(p.stat().st_size for p in file.rglob("*"))
        if file.is_dir()
        else file.stat().st_size,
        "frames": recorded.frames,
        "bbox": recorded.bbox,
        "seconds": time.perf_counter() - start,
    }
    _write(campaign.out / "recorded" / f"{plan.id}.json", out)
    return out


def run_campaign(
    campaign: Campaign, jobs: int, progress: Callable[[str, int, int, dict[str, Any]], None]
) -> list[tuple[dict[str, Any], dict[str, Any] | None]]:
    """Run all trials; gives (truth, recording) of each one wanted, by index.

    progress is called as progress(phase, done, total, result) after each trial.
    """
    for folder in (campaign.out / "truth", campaign.out / "recorded", campaign.recordings):
        folder.mkdir(parents=True, exist_ok=True)
    proved: list[dict[str, Any]] = []
    quota: dict[str, int] = {}
    if campaign.indices is None and campaign.scenario.choose is not None:
        quota = {str(kind): n for kind, n in campaign.scenario.choose.items()}
    if campaign.indices is not None:
        blocks: Iterator[tuple[int, ...]] = iter([campaign.indices])
    elif quota:
        most = campaign.trials * campaign.scenario.max_attempts
        blocks = (tuple(range(a, min(a + BLOCK, most))) for a in range(0, most, BLOCK))
    else:
        blocks = iter([tuple(range(campaign.trials))])
    chosen: list[dict[str, Any]] = []
    with _pool(jobs) as over:
        if campaign.scenario.hand is not None:
            names = _names(campaign)
            held = []
            for k, found in enumerate(over(find_grasps, campaign, tuple(range(len(names))))):
                progress("grasps", k + 1, len(names), found)
                held += [found["id"]] if found["count"] else []
            if not held:
                raise UsageError(f"{campaign.scenario.gripper.name} holds none of the objects")
            scenario = campaign.scenario.model_copy(update={"objects": tuple(held)})
            campaign = replace(campaign, scenario=scenario)
        for block in blocks:
            for k, result in enumerate(over(prove_trial, campaign, block)):
                proved.append(result)
                kind = result["verdict"]["failure_class"] or "success"
                is_known = result["verdict"]["outcome"] != "unknown"
                if is_known and (not quota or quota.get(kind, 0) > 0):
                    chosen.append(result)
                    if quota:
                        quota[kind] -= 1
                progress("simulate", k + 1, len(block), result)
            if quota and not any(n > 0 for n in quota.values()):
                break
        recorded: list[dict[str, Any] | None] = [None] * len(chosen)
        if campaign.images:
            for k, result in enumerate(
                over(record_trial, campaign, tuple(c["index"] for c in chosen))
            ):
                recorded[k] = result
                progress("record", k + 1, len(chosen), result)
    shutil.rmtree(campaign.out / "part", ignore_errors=True)
    pairs = list(zip(chosen, recorded, strict=True))
    if not campaign.stranger:
        write_manifest(campaign, pairs)
    _write(campaign.out / "simulated.json", {"simulated": proved})
    return pairs


def unstable_trials(out: Path) -> list[str]:
    """The trials of a finished campaign whose physics was unstable: nothing is known of them."""
    made = json.loads((out / "simulated.json").read_text(encoding="utf-8"))["simulated"]
    return [t["id"] for t in made if t["verdict"]["outcome"] == "unknown"]


class _pool:
    """`over(function, campaign, indices)` gives results in the order of the indices.

    They are computed in this process or in several.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Callable[..., Iterator[dict[str, Any]]]:
        if self._jobs == 1:
            return lambda function, campaign, indices: (function(campaign, i) for i in indices)
        set_thread_variables()
        self._pool = ProcessPoolExecutor(
            self._jobs, mp_context=multiprocessing.get_context("spawn")
        )
        pool = self._pool
        return lambda function, campaign, indices: pool.map(
            function, [campaign] * len(indices), indices
        )

    def __exit__(self, *error: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)


def _finished(path: Path, key: str) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        value: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return None  # cut off while it was written
    return value if value.get("key") == key else None


def _write(path: Path, value: dict[str, Any]) -> None:
    part = path.with_suffix(".part")
    part.write_text(json.dumps(value, indent=1, sort_keys=True), encoding="utf-8")
    part.rename(path)


def _physics_hash(run: Run) -> str:
    total = hashlib.sha256()
    for tick in run.ticks:
        total.update(tick.snapshot.state.tobytes())
    return total.hexdigest()


def platform_name() -> str:
    """Short name of this platform fingerprint, for hashes that hold on it alone."""
    return hashlib.sha256(json.dumps(fingerprint(), sort_keys=True).encode()).hexdigest()[:12]


def write_manifest(
    campaign: Campaign, pairs: list[tuple[dict[str, Any], dict[str, Any] | None]]
) -> None:
    """Write OUT/<scenario>.toml: the trials, what they were made from, the recordings' hashes."""
    lines = [
        f'name = "{campaign.scenario.name}"',
        "",
        "[simulate] # what it was made from: `dgeval simulate` makes it again",
    ]
    lines += [f'scenario = "{campaign.scenario.name}"', f"seed = {campaign.seed}"]
    lines += [f"indices = {[t['index'] for t, _ in pairs]}", f'platform = "{platform_name()}"']
    if isinstance(hand := campaign.scenario.gripper, ImportedHand):
        lines.append(f'hand_sha256 = "{hand.sha256}"')
    lines.append("")
    for truth, recording in pairs:
        verdict = truth["verdict"]
        lines += [
            "[[trial]]",
            f'id = "{truth["id"]}"',
            f'recording = "{recording_name(campaign, truth["id"])}"',
        ]
        if recording is not None:
            lines.append(f'sha256 = "{recording["sha256"]}"')
            if recording["bbox"] is not None:
                lines.append(f"bbox = {list(recording['bbox'])}")
        lines += [
            f'object = "{verdict["object"]}"',
            f'scenario = "{campaign.scenario.name}"',
            f"speed = {abs(verdict['speed'])}",
            "",
        ]
    (campaign.out / f"{campaign.scenario.name}.toml").write_text("\n".join(lines), encoding="utf-8")
