"""dgeval from Python: open a trial, replay it, look back at it, judge it, read a finished run.

The page docs/api.md has an example that runs as a test.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from dgeval.config import Config, load_config
from dgeval.determinism import limit_threads
from dgeval.errors import Place, UsageError
from dgeval.hindsight import second_pass
from dgeval.hindsight.second_pass import Hindsight
from dgeval.hindsight.surface import CausalFrame, Surface, causal_frame_of
from dgeval.perception.pipeline import Perception
from dgeval.recording import trials
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import Trial
from dgeval.replay import causal
from dgeval.replay.causal import Step
from dgeval.replay.target_search import search_target
from dgeval.runs.results import Run, read_run
from dgeval.verdict.judge import Judgement, judge
from dgeval.verdict.log import log_of


def open_trial(path: Path, config: Config | None = None, trial: str | None = None) -> Trial:
    """A trial of a recording, folder or manifest, ready to be read.

    config: of `dgeval.config.load_config`; default that of the pipeline `dynamic`. trial: its id,
    needed where there are several; a recording's id is its file name without suffix. Images are
    read later, in `replay_trial` and `look_back`. UnreadableError where nothing can be read,
    UsageError where not exactly one trial fits; it names the trials there are.
    """
    config = config or load_config("dynamic", ())
    specs = find_trials([path], config.roles.events)
    chosen = [s for s in specs if trial in (None, s.id)]
    if len(chosen) != 1:
        ids = ", ".join(s.id for s in specs)
        what = "several trials" if trial is None else f"no trial {trial!r}"
        raise UsageError(what, Place(str(path)), f"name one of {ids}")
    return trials.open_trial(chosen[0], config)


def replay_trial(trial: Trial, perception: Perception | None = None) -> Iterator[Step]:
    """The causal pass: frames in order, each with what the stages made of it.

    `Step.row` is the frame's row of the frames table; keys of null columns may be missing.
    perception: a new `Perception(trial.config)`, to keep for `look_back`. Sets one thread in numpy,
    OpenCV and torch for this process, so that the rows are those of `dgeval replay`.
    """
    limit_threads()
    target = search_target(trial, trial.config) if trial.spec.bbox is None else None
    return causal.replay(trial, trial.config, perception, target)


def look_back(trial: Trial, steps: Iterable[Step], perception: Perception) -> Hindsight | None:
    """The second pass, with the whole log known: path, sightings and contacts of the object.

    steps: all of `replay_trial` with this perception. They hold images: pass the iterator on
    instead of a list. Images are read a second time. None where the object was never tracked.
    """
    frames: list[CausalFrame] = []
    surface = Surface()
    for step in steps:
        if (known := causal_frame_of(step)) is not None:
            frames.append(known)
        if step.accepted and step.model is not None:
            surface.add(step.model)
    return second_pass.look_back(trial, frames, surface, perception, trial.config)


def judge_trial(trial: Trial, hindsight: Hindsight | None) -> Judgement:
    """The verdict: outcome, class with probabilities, blame, evidence, and the decisive moment ns.

    hindsight: of `look_back`. Nothing reads the recorded truth. A failure takes up to a minute: the
    twin closes the hand at other times.
    """
    return judge(log_of(trial), hindsight, trial.config.verdict, trial.config.seed)


def load_run(folder: Path) -> Run:
    """A finished run folder of `dgeval replay`: its tables as pandas frames.

    UsageError where the folder is no finished run.
    """
    return read_run(folder)
