"""The verdict as a user meets it: recordings of trials are rendered, replayed from the recording
alone, and set against the simulator's truth.

Friction, masses, contacts, links and solver differ from trial to trial and are not recorded. What
is finished is kept: truth and recording in OUT/<arm>, verdicts in OUT/<arm>/run-<condition>. A
condition takes from the recordings what another log would not hold; nothing is simulated again.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer

from dgeval.config import Config, load_config
from dgeval.evaluate.agreement import Judged
from dgeval.recording.contract import OWN_PREFIXES
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.runs.folder import TrialResult, finish_run
from dgeval.runs.workers import replay_trials
from dgeval.simulation.campaign import Campaign, run_campaign
from dgeval.simulation.imported_hand import ImportedHand
from dgeval.simulation.physics import PhysicsConfig
from dgeval.simulation.record import START_NS
from dgeval.simulation.scenario import Scenario, load_scenario, with_hand

SCENARIOS = ("failures", "handover")
RECORDED, STRANGER, LABELLED = CONDITIONS = ("recorded", "stranger", "labelled")
LABELS = ("success", "failure")  # an operator's words
TRIALS = 40  # of each arm; ours
LONG_TRUTH_S = 60.0  # of a truth that took longer it is said


@dataclass(frozen=True)
class VerdictArm:
    """One scenario with one hand."""

    name: str
    scenario: Scenario

    @property
    def config(self) -> Config:
        """As a user would replay it: the pipeline of the task, and where the hand's meshes are."""
        pipeline = "dynamic" if self.scenario.presenter is None else "handover"
        hand = self.scenario.gripper
        if not isinstance(hand, ImportedHand):
            return load_config(pipeline)
        named = ", ".join(f'"{folder}"' for folder in hand.mesh_dirs)
        return load_config(pipeline, (f"calibration.mesh_dirs=[{named}]",))


def arms_of(hands: list[Path]) -> list[VerdictArm]:
    """The arms of a suite: each scenario with its own hand, or the belt with each given hand."""
    physics = PhysicsConfig()
    if not hands:
        return [VerdictArm(name, _varied(load_scenario(name), physics)) for name in SCENARIOS]
    belt = load_scenario(SCENARIOS[0])
    return [
        VerdictArm(f"{SCENARIOS[0]}-{hand.stem}", _varied(with_hand(belt, hand), physics))
        for hand in hands
    ]


def _varied(scenario: Scenario, physics: PhysicsConfig) -> Scenario:
    return scenario.model_copy(update={"choose": None, "physics": physics})


def run_arm(
    arm: VerdictArm,
    conditions: tuple[str, ...],
    seed: int,
    trials: int,
    meshes: Path | None,
    out: Path,
    jobs: int,
    progress: Callable[[str, int, int, dict[str, Any]], None],
) -> list[Judged]:
    """Simulate, record, replay and judge the trials of an arm under each of CONDITIONS that is
    asked for; those whose physics was unstable are left out.

    meshes: folder of objects in place of the ten.
    """
    folder = out / arm.name
    campaign = Campaign(arm.scenario, seed, trials, folder, meshes, labels_only=True)
    made = [(truth, r) for truth, r in run_campaign(campaign, jobs, progress) if r is not None]
    truths = {truth["id"]: truth for truth, _ in made}
    judged = []
    for condition in conditions:
        files = [campaign.recordings / r["recording"] for _, r in made]
        if condition != RECORDED:
            files = [_without_own_topics(file, folder / STRANGER) for file in files]
        specs = find_trials(files)
        if condition == LABELLED:
            specs = [_labelled(spec, truths[spec.recording.stem]["verdict"]) for spec in specs]
        done = itertools.count(1)

        def tell(
            result: TrialResult,
            phase: str = f"judge, {condition}",
            done: Iterator[int] = done,
            total: int = len(specs),
        ) -> None:
            progress(phase, next(done), total, {"id": result.id})

        run = folder / f"run-{condition}"
        results = replay_trials(specs, arm.config, run, None, False, jobs, tell)
        finish_run(run, results, arm.config)
        by_file: dict[str, list[TrialResult]] = {}
        for spec, result in zip(specs, results, strict=True):
            by_file.setdefault(spec.recording.stem, []).append(result)
        judged += [_judged(arm, condition, truths[name], by_file[name]) for name in truths]
    return judged


def _labelled(spec: TrialSpec, true: dict[str, Any]) -> TrialSpec:
    """With the word of an operator who saw how it ended."""
    return replace(spec, label=true["outcome"]) if true["outcome"] in LABELS else spec


def _without_own_topics(file: Path, folder: Path) -> Path:
    """A copy of a recording as a robot would write it that has never heard of dgeval."""
    copy = folder / file.name
    folder.mkdir(exist_ok=True)
    part = copy.with_name(copy.name + ".part")
    with file.open("rb") as source, part.open("wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start(profile="ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            if channel.topic.startswith(OWN_PREFIXES) or schema is None:
                continue
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[schema.id],
                    dict(channel.metadata),
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()  # type: ignore[no-untyped-call]
    part.replace(copy)
    return copy


def _judged(
    arm: VerdictArm, condition: str, truth: dict[str, Any], found: list[TrialResult]
) -> Judged:
    """found: the trials that dgeval made of the recording; of more than one none is the trial."""
    result = found[0]
    if len(found) > 1:
        what = f"one trial's recording was taken for {len(found)}"
        result = TrialResult(truth["id"], None, found[0].exit_code, [what], None)
    true = truth["verdict"]
    close_s = true["t_close_s"]
    close_ns = None if close_s is None else START_NS + round(close_s * 1e9)
    seconds = truth["seconds"]["truth"]
    marks = (f"its truth took {seconds:.0f} s",) if seconds > LONG_TRUTH_S else ()
    return Judged(
        result.id,
        arm.name,
        result.row,
        {**true, "t_close_ns": close_ns},
        tuple(result.messages),
        result.exit_code,
        marks,
        condition,
    )
