"""Replay of one trial into the run folder: its files, its commit mark, and resuming."""

from __future__ import annotations

import hashlib
import json
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgeval import __version__
from dgeval.config import Config, ReviewConfig
from dgeval.determinism import limit_threads
from dgeval.errors import EXIT_DATA_LOST, EXIT_INTERNAL, EXIT_OK, DgevalError, describe
from dgeval.geometry import Array
from dgeval.hindsight.chosen_grasp import hindsight_score
from dgeval.hindsight.second_pass import Hindsight, look_back
from dgeval.hindsight.surface import CausalFrame, Surface, causal_frame_of
from dgeval.perception.pipeline import Perception
from dgeval.planning.control import Choice
from dgeval.recording.containers.container import sha256_of
from dgeval.recording.contract import CLOSE_EVENT
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.trials import Trial, open_trial
from dgeval.replay.causal import Step, closing_threshold, replay
from dgeval.replay.fidelity import Compared, Fidelity, fidelity_notes, spread_of
from dgeval.replay.notes import FrameCounts, pipeline_notes, recording_notes, self_filter_of
from dgeval.replay.row import pose_columns
from dgeval.replay.target_search import FoundTarget, search_target
from dgeval.runs.estimates import shown_as_json
from dgeval.runs.files import TableFile, file_name, write_atomically, write_ply, write_table
from dgeval.runs.folder import TrialResult
from dgeval.runs.target_told import (
    FirstSeen,
    first_seen,
    target_checks,
    target_note,
    target_source,
    write_target,
)
from dgeval.schema import (
    FRAMES,
    FRAMES_ADDED,
    HINDSIGHT,
    NOTES_APART,
    SCHEMA_VERSION,
    TIMINGS,
    StageDigests,
    arrow_table,
)
from dgeval.verdict.estimates import Estimates
from dgeval.verdict.judge import Judgement, judge
from dgeval.verdict.log import log_of
from dgeval.verdict.picture import decisive_picture

MAX_RECENT = 400  # compressed images kept, of which one becomes the picture of the decisive moment
# Makes the object that writes a trial's review recording: add(step) for each frame, at the end
# close(path, hindsight, judgement).
ReviewFactory = Callable[[Path, Trial, ReviewConfig], Any]


def resume_key(
    spec: TrialSpec, config: Config, sha256: str, estimates: Estimates | None = None
) -> str:
    """SHA-256 of all that a trial's result depends on, to tell whether it can be kept.

    The recording's content is part of it; its folder and name are not. So is the content of the
    files that the configuration names: weights, a description, a mask.
    """
    given_files = config.files()
    if config.vfas.contact_graspnet == "installed":
        from dgeval.networks.contact_graspnet import installed_weights  # imports torch

        given_files["vfas.contact_graspnet"] = installed_weights() or Path("installed")
    files = {k: sha256_of(p) for k, p in given_files.items() if p.is_file()}
    about = {k: v for k, v in asdict(spec).items() if k not in ("recording", "parts")}
    given = [] if estimates is None else [estimates.sha256]
    text = json.dumps(
        [__version__, SCHEMA_VERSION, config.model_dump(mode="json"), files, about, sha256, *given],
        sort_keys=True,
    )
    return hashlib.sha256(text.encode()).hexdigest()


def replay_trial(
    spec: TrialSpec,
    config: Config,
    out: Path,
    review: ReviewFactory | None,
    force: bool,
    progress: Callable[[int, int], None] | None = None,
    sha256: str | None = None,
    estimates: Estimates | None = None,
) -> TrialResult:
    """Replay one trial into the run folder; the commit mark `trials/<trial>.json` is written last.

    review: None writes no review recording. force: replay also what is finished. progress(done,
    total): called after each frame. sha256: of the recording where it is known already.
    estimates: what other trials show of the hand.

    Errors become messages with an exit code. The traceback of an internal error goes into the
    run's log.
    """
    limit_threads()
    try:
        return _replay_trial(spec, config, out, review, force, progress, sha256, estimates)
    except DgevalError as error:
        return TrialResult(spec.id, None, error.exit_code, [str(error)], None)
    except Exception as error:  # the boundary of a trial: one must not take the others down
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}:{last.lineno}"
        what = (
            f"internal error: {describe(error)} at {where}; the traceback is in the run's log.jsonl"
        )
        return TrialResult(
            spec.id, None, EXIT_INTERNAL, [what], None, traceback=traceback.format_exc()
        )


def _replay_trial(
    spec: TrialSpec,
    config: Config,
    out: Path,
    review: ReviewFactory | None,
    force: bool,
    progress: Callable[[int, int], None] | None,
    sha256: str | None,
    estimates: Estimates | None,
) -> TrialResult:
    trial = open_trial(spec, config, sha256)
    config = trial.config
    key = resume_key(spec, config, trial.sha256, estimates)
    name = file_name(spec.id)
    mark = out / "trials" / f"{name}.json"
    if not force:
        kept = _committed(mark, key, out, name, review is not None)
        if kept is not None:
            return TrialResult(
                spec.id,
                kept["row"],
                kept["exit_code"],
                kept["messages"],
                trial.sha256,
                True,
                kept["review"],
                shown=kept["shown"],
            )
    mark.unlink(missing_ok=True)
    for folder in ("frames", "models", "review", "trials"):
        (out / folder).mkdir(parents=True, exist_ok=True)

    review_writer = (
        review(out / "review" / f"{name}.rrd.part", trial, config.review)
        if review is not None
        else None
    )
    digests = StageDigests()
    counts = FrameCounts()
    t_execute_ns = None
    chosen: tuple[Choice, Array] | None = None
    model = None
    last_ns = trial.pairs[-1][0]
    close_ns = trial.event_ns(CLOSE_EVENT)
    target = search_target(trial, config) if spec.bbox is None else None
    seen: FirstSeen | None = None
    perception, compared = Perception(config), Compared(trial, config)
    observed: list[CausalFrame] = []
    surface = Surface()
    # time ns, T_base_camera and image, for the picture of the decisive moment
    recent: deque[tuple[int, Array | None, bytes]] = deque(maxlen=MAX_RECENT)
    frames_path = out / "frames" / f"{name}.parquet"
    timings_path = out / "trials" / f"{name}.timings.parquet"
    with (
        TableFile(frames_path, (*FRAMES, *FRAMES_ADDED)) as frames_table,
        TableFile(timings_path, TIMINGS) as timings_table,
    ):
        for step in replay(trial, config, perception, target):
            digests.add(step.row)
            frames_table.add(step.row)
            for stage, seconds in step.seconds.items():
                timings_table.add(
                    {
                        "trial": spec.id,
                        "frame": step.frame.index,
                        "stage": stage,
                        "seconds": seconds,
                    }
                )
            counts = counts.with_frame(step)
            compared.add(step)
            if seen is None and step.tracked.box is not None:
                seen = first_seen(step, trial, target, config)
                if spec.bbox is None:
                    write_target(out / "pictures" / f"{name}-target.png", step)
            if t_execute_ns is None and (t_execute_ns := step.execute_ns) is not None:
                chosen = _chosen(step)
            model = step.model if step.model is not None else model
            last_ns = step.frame.t_ns
            if (observation := causal_frame_of(step)) is not None:
                observed.append(observation)
            if step.accepted and step.model is not None:
                surface.add(step.model)
            if close_ns is None or step.frame.t_ns <= close_ns:
                recent.append((step.frame.t_ns, step.T_base_camera, _as_jpeg(step)))
            if review_writer is not None:
                review_writer.add(step)
            if progress is not None:
                progress(step.frame.index + 1, len(trial.pairs))
        start = time.perf_counter()
        hindsight = look_back(trial, observed, surface, perception, config)
        hindsight_done = time.perf_counter()
        elsewhere = None if estimates is None else estimates.of(trial.robot.hand_found)
        log = log_of(trial, elsewhere)
        if not log.recorded.is_complete and compared.speaks(close_ns or last_ns):
            log = replace(log, recorded=log.recorded.completed_by(compared.own))
        judgement = judge(log, hindsight, config.verdict, config.seed)
        for stage, seconds in (
            ("hindsight", hindsight_done - start),
            ("verdict", time.perf_counter() - hindsight_done),
        ):
            timings_table.add(
                {"trial": spec.id, "frame": counts.frames, "stage": stage, "seconds": seconds}
            )
    sizes = (
        review_writer.close(out / "review" / f"{name}.rrd", hindsight, judgement)
        if review_writer is not None
        else None
    )
    if hindsight is not None:
        _write_picture(out / "pictures" / f"{name}.jpg", recent, judgement, hindsight, trial)
        (out / "hindsight").mkdir(exist_ok=True)
        write_table(
            out / "hindsight" / f"{name}.parquet",
            arrow_table(HINDSIGHT, _hindsight_rows(hindsight)),
        )
    if model is not None:
        write_ply(out / "models" / f"{name}.ply", model.points, model.normals)

    decisive_ns = judgement.decisive_ns or close_ns or last_ns
    fidelity = compared.until(decisive_ns)
    if config.fidelity.seeds and any(one.is_faithful is False for one in fidelity):
        spread = spread_of(trial, config, compared.own, decisive_ns, target)
        fidelity = compared.until(decisive_ns, spread)

    chosen_score = None
    if chosen is not None and t_execute_ns is not None and hindsight is not None:
        chosen_score = hindsight_score(*chosen, t_execute_ns, hindsight, config.grasps)
    row, exit_code, messages = trial_row(
        trial,
        config,
        counts,
        t_execute_ns,
        last_ns,
        judgement,
        target,
        seen,
        estimates,
        (perception.noise.told(),),
        fidelity,
        chosen_score,
    )
    row.update({f"digest_{stage}": value for stage, value in digests.hexdigests().items()})
    shown = None if judgement.shown is None else shown_as_json(judgement.shown)
    kept = {
        "key": key,
        "row": row,
        "exit_code": exit_code,
        "messages": messages,
        "review": sizes,
        "shown": shown,
    }
    write_atomically(mark, json.dumps(kept, indent=1))
    return TrialResult(spec.id, row, exit_code, messages, trial.sha256, review=sizes, shown=shown)


def _chosen(step: Step) -> tuple[Choice, Array] | None:
    """The grasp chosen when the fingers would have closed, and T_base_camera of the frame."""
    grasps = None if step.executed is None else step.executed.grasps
    if grasps is None or grasps.choice is None or step.T_base_camera is None:
        return None
    return grasps.choice, step.T_base_camera


def trial_row(
    trial: Trial,
    config: Config,
    counts: FrameCounts,
    t_execute_ns: int | None,
    last_ns: int,
    judgement: Judgement,
    target: FoundTarget | None = None,
    seen: FirstSeen | None = None,
    estimates: Estimates | None = None,
    perceived: tuple[str, ...] = (),
    fidelity: tuple[Fidelity, ...] = (),
    chosen_score: float | None = None,
) -> tuple[dict[str, Any], int, list[str]]:
    """The trial's row without its digests, the exit code, and messages for the user.

    t_execute_ns: when the replay would have closed first. last_ns: time of
    the last frame. target: as it was found, where no box was given. seen: where it was first seen.
    estimates: as given to the run. perceived: notes of the perception. fidelity: of the replay
    to the robot. chosen_score: in hindsight, of the grasp chosen at t_execute_ns.
    """
    spec = trial.spec
    messages = [f"damage: {d}" for d in trial.damage]
    exit_code = EXIT_DATA_LOST if trial.damage else EXIT_OK
    before = [check.name for check in trial.checks]
    of_target = target_checks(counts, spec.bbox is not None, seen, config.tracking.method, before)
    for check in (*trial.checks, *of_target):
        if check.name not in config.checks.accept:
            exit_code = EXIT_DATA_LOST
            messages.append(str(check))
    row: dict[str, Any] = {
        "trial": spec.id,
        "recording": spec.recording.name,
        "pipeline": config.pipeline,
        "base_frame": trial.robot.base_frame or trial.robot.camera_frame,
        "scenario": spec.scenario,
        "object": spec.object,
        "speed": spec.speed,
        "t_start_ns": spec.start_ns,
        "t_end_ns": max(spec.end_ns or last_ns, last_ns),
        "n_frames": counts.frames,
        "n_lost": counts.lost,
        "n_predicted": counts.predicted,
        "self_filter": self_filter_of(trial, counts),
        "target_source": target_source(trial, target),
        "t_execute_ns": t_execute_ns,
        "c_e": closing_threshold(trial, config),
        "execute_in_window": judgement.holds_at(t_execute_ns, trial.event_ns(CLOSE_EVENT)),
        "hindsight_score_at_execute": chosen_score,
        "t_close_ns": trial.event_ns(CLOSE_EVENT),
        "close_source": trial.close.source,
        "t_fingers_ns": trial.close.fingers_ns,
        "cause_given": spec.cause,
        "t_decisive_ns": judgement.decisive_ns,
        "contact_link": judgement.link,
        "estimates": None if estimates is None else estimates.sha256,
        "notes": NOTES_APART.join(
            [
                *map(str, of_target),
                *recording_notes(trial, counts),
                *target_note(trial, target),
                *_other_word(spec.cause, judgement),
                *judgement.notes,
                *perceived,
                *fidelity_notes(fidelity),
                *pipeline_notes(trial, config, counts),
            ]
        ),
        **{f"fidelity_{one.stage}": one.word for one in fidelity},
        **asdict(judgement.row),
    }
    return row, exit_code, messages


def _other_word(given: str | None, judgement: Judgement) -> list[str]:
    """A note where an operator's word for the cause is neither of the verdict's two classes."""
    row = judgement.row
    if (
        given is None
        or given == row.observed_class
        or row.failure_class in (None, "unknown", given)
    ):
        return []
    return [f"an operator says {given}, the verdict {row.failure_class}"]


def _hindsight_rows(hindsight: Hindsight) -> list[dict[str, Any]]:
    """The rows of the table `hindsight`."""
    return [
        {
            "frame": m.index,
            "t_ns": m.t_ns,
            "by": m.by,
            "sd": m.sd,
            "hand_distance": m.distance,
            "hand_link": m.link,
            **pose_columns("object", m.T_base_model),
        }
        for m in hindsight.moments
    ]


def _as_jpeg(step: Step) -> bytes:
    """The colour image as recorded if it was compressed, else as JPEG, so that many fit memory."""
    if step.frame.colour_file is not None:
        return step.frame.colour_file
    return cv2.imencode(".jpg", step.frame.colour[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[
        1
    ].tobytes()


def _write_picture(
    path: Path,
    recent: deque[tuple[int, Array | None, bytes]],
    judgement: Judgement,
    hindsight: Hindsight,
    trial: Trial,
) -> None:
    """Draw the frame nearest to the decisive moment; without such a moment the last frame.

    recent: time ns, T_base_camera (4, 4) and compressed image of the frames to choose from.
    """
    wanted_ns = (
        judgement.decisive_ns
        if judgement.decisive_ns is not None
        else recent[-1][0]
        if recent
        else 0
    )
    usable = [r for r in recent if r[1] is not None]
    if not usable:
        return
    t_ns, T_base_camera, data = min(usable, key=lambda r: abs(r[0] - wanted_ns))
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert T_base_camera is not None
    label = judgement.row.failure_class or judgement.row.outcome
    title = f"{trial.spec.id}  {(t_ns - trial.pairs[0][0]) * 1e-9:.2f} s  {label}"
    drawn = decisive_picture(
        np.asarray(image, dtype=np.uint8), t_ns, T_base_camera, trial.camera, hindsight, title
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_bytes(cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 82])[1].tobytes())
    part.replace(path)


def _committed(mark: Path, key: str, out: Path, name: str, review: bool) -> dict[str, Any] | None:
    """The commit mark of a finished trial with the same inputs, if all its files are there."""
    try:
        kept: dict[str, Any] = json.loads(mark.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    needed = [out / "frames" / f"{name}.parquet", out / "trials" / f"{name}.timings.parquet"]
    if review:
        needed.append(out / "review" / f"{name}.rrd")
    is_whole = kept.get("key") == key and "shown" in kept
    return kept if is_whole and all(p.is_file() for p in needed) else None
