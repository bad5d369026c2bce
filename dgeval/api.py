"""dgeval from Python: open a trial, replay it, look back at it, judge it, read a finished run.

The page docs/api.md has an example that runs as a test.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from dgeval.config import Config, load_config
from dgeval.errors import UsageError
from dgeval.hindsight import second_pass
from dgeval.hindsight.second_pass import Hindsight
from dgeval.hindsight.surface import Seen, Surface, seen_of
from dgeval.perception.pipeline import Perception
from dgeval.recording import trials
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import Trial
from dgeval.replay import causal
from dgeval.replay.causal import Step
from dgeval.runs.results import Run, read_run
from dgeval.verdict.judge import Judgement, judge


def open_trial(path: Path, config: Config | None = None, trial: str | None = None) -> Trial:
    """A trial of a recording or manifest, ready to be read.

    config: default that of the pipeline `dynamic`. trial: its id, needed where there are several.
    Errors: UnreadableError, UsageError.
    """
    config = config or load_config("dynamic", ())
    specs = [s for s in find_trials([path], config.roles.events) if trial in (None, s.id)]
    if len(specs) != 1:
        raise UsageError(f"{len(specs)} trials in {path}, one is needed", hint="name it by its id")
    return trials.open_trial(specs[0], config)


def replay_trial(trial: Trial, perception: Perception | None = None) -> Iterator[Step]:
    """The causal pass: frames in order, each with what the stages made of it; `Step.row` is its table row.

    perception: a new `Perception(trial.config)` to keep for `look_back`.
    """
    return causal.replay(trial, trial.config, perception)


def look_back(trial: Trial, steps: Iterable[Step], perception: Perception) -> Hindsight | None:
    """The second pass, after all steps of `replay_trial` with this perception; reads the images again.

    None where the object was never tracked. Steps hold images: pass them on as they come.
    """
    seen: list[Seen] = []
    surface = Surface()
    for step in steps:
        if (known := seen_of(step)) is not None:
            seen.append(known)
        if step.accepted and step.model is not None:
            surface.add(step.model)
    return second_pass.look_back(trial, seen, surface, perception, trial.config)


def judge_trial(trial: Trial, hindsight: Hindsight | None) -> Judgement:
    """Outcome, class, probabilities, blame and evidence of a trial, and the decisive moment ns."""
    return judge(trial, hindsight, trial.config)


def load_run(folder: Path) -> Run:
    """A finished run folder: its tables as pandas frames. UsageError where it is none."""
    return read_run(folder)
