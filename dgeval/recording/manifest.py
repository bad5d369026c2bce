"""The trials that paths and manifests name: which part of which recording, and its metadata."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from dgeval.config import read_toml, validated
from dgeval.errors import Place, UndecodableError, UnreadableError, UsageError
from dgeval.recording.containers.container import MCAP_MAGIC
from dgeval.recording.containers.opening import BAG_MAGIC, PACKED, open_container, stored_files
from dgeval.recording.contract import (
    EVENTS_TOPIC,
    FAILURE_LABELS,
    SUCCESS_LABELS,
    TRIAL_END_EVENT,
    TRIAL_START_EVENT,
    label_of,
)
from dgeval.recording.copies import holds_a_recording, repeats
from dgeval.recording.events import heard_once, pressed_once
from dgeval.recording.messages import Event, read_event
from dgeval.recording.pauses import between_pauses
from dgeval.recording.splits import split_recordings

SUFFIXES = (".mcap", ".bag", ".db3")
# behind a recording's name: packed otherwise, or a copy that was not finished; a run names them
NOT_READ = (".lz4", ".gz", ".xz", ".bz2", ".7z", ".zip", ".part", ".tmp")
UNFINISHED = ".active"  # behind the name of a bag that its recorder did not finish
NO_RECORDING = (".rrd", ".parquet", ".json", ".toml", ".yaml", ".py", ".md")


class _ManifestTrial(BaseModel):
    model_config = ConfigDict(extra="forbid")
    id: str | None = None
    recording: str | Annotated[list[str], Field(min_length=1)]
    sha256: str | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    frames: tuple[int, int] | None = None
    bbox: tuple[float, float, float, float] | None = None
    bbox_time_ns: int | None = None
    object: str | None = None
    scenario: str | None = None
    speed: float | None = None
    label: str | None = None
    cause: Literal["imprecise_pose", "collision", "timing"] | None = None
    close_ns: int | None = None
    lift_ns: int | None = None

    @field_validator("label")
    @classmethod
    def _known(cls, value: str | None) -> str | None:
        if value is None:
            return None
        label = label_of(value)
        if label is None:
            words = ", ".join((*SUCCESS_LABELS, *FAILURE_LABELS))
            raise ValueError(f"a label is one of {words}, not {value!r}")
        return label


class _Manifest(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = ""
    # how simulated recordings are made again; not needed to read them
    simulate: dict[str, Any] = {}
    trial: list[_ManifestTrial]


@dataclass(frozen=True)
class TrialSpec:
    """One trial to replay: an entry of a manifest, or a recording's own trial. Times ns, box px.

    frames: [first, last) of the paired frames. bbox: x0, y0, x1, y1 of the target, from
    bbox_time_ns on. label: an operator's, success or failure. cause: an operator's word for why.
    close_ns, lift_ns: of the commands, where a person knows better than the log; close_after_s,
    lift_after_s: likewise, s after the first frame. sha256: of the
    recording, as the manifest says. parts: the files that together are the recording: of one that
    was split, in order, or of several computers.
    window_is_log_time: start and end are of messages without a time of their own, as logged.
    is_between_pauses: start and end are pauses of the recorder, and nobody's word. repeats: of a
    file that holds what another one of the run holds, what it is.
    """

    id: str
    recording: Path
    start_ns: int | None = None
    end_ns: int | None = None
    frames: tuple[int, int] | None = None
    bbox: tuple[float, float, float, float] | None = None
    bbox_time_ns: int | None = None
    object: str | None = None
    scenario: str | None = None
    speed: float | None = None
    label: str | None = None
    sha256: str | None = None
    cause: str | None = None
    close_ns: int | None = None
    lift_ns: int | None = None
    close_after_s: float | None = None
    lift_after_s: float | None = None
    parts: tuple[Path, ...] = ()
    window_is_log_time: bool = False
    is_between_pauses: bool = False
    repeats: str | None = None


def find_trials(paths: list[Path], events_topic: str | None = None) -> list[TrialSpec]:
    """Trials of recordings, folders of recordings and manifests, with unique ids.

    UsageError, UnreadableError.
    """
    specs: list[TrialSpec] = []
    by_manifest: set[Path] = set()  # which says by itself what is a trial
    for parts in split_recordings(paths):
        path = parts[0]
        if len(parts) > 1:
            name = path.stem[: -len("_0")]
            specs.extend(_of_recording(path, name, events_topic, parts))
        elif path.suffix == ".toml":
            listed = _from_manifest(path)
            by_manifest |= {spec.recording for spec in listed}
            specs.extend(listed)
        elif path.is_dir() and not _is_recording(path):
            specs.extend(_in_folder(path, events_topic))
        else:
            specs.extend(
                _of_recording(
                    path, path.stem if path.suffix in SUFFIXES else path.name, events_topic
                )
            )
    whole = [s.recording for s in specs if s.recording not in by_manifest and not s.parts]
    repeated = repeats(list(dict.fromkeys(whole)))
    specs = [replace(s, repeats=repeated.get(s.recording)) for s in specs]
    ids = [s.id for s in specs]
    twice = sorted({i for i in ids if ids.count(i) > 1})
    if twice:
        raise UsageError(
            f"trial ids are not unique: {', '.join(twice)}",
            hint="give a manifest with an id per trial",
        )
    return specs


def _in_folder(folder: Path, events_topic: str | None) -> list[TrialSpec]:
    """The trials of every recording below a folder.

    One that can't be opened is a trial too, so that the run names it.
    """
    inside = sorted(
        p
        for p in folder.rglob("*")
        if _is_recording(p) and not any(_is_recording(a) for a in p.parents if folder in a.parents)
    )
    if not inside:
        raise UnreadableError(
            "no recording (.mcap, .bag, .db3) below this folder", Place(str(folder))
        )
    out = []
    for parts in split_recordings(inside):
        first = parts[0]
        relative = first.relative_to(folder)
        name = str(relative)
        while first.is_file() and (suffix := Path(name).suffix) in (*SUFFIXES, *PACKED, UNFINISHED):
            name = name[: -len(suffix)]
        if len(parts) > 1:
            name = name[: -len("_0")]
        try:
            out.extend(_of_recording(first, name, events_topic, parts if len(parts) > 1 else ()))
        except UnreadableError:
            out.append(TrialSpec(name, first))
    return out


def _is_recording(path: Path) -> bool:
    """Whether a path is a recording: a ROS 2 folder with metadata.yaml, or a file by its suffix or
    first bytes.

    In a folder without metadata each file is a recording of its own.
    """
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and bool(stored_files(path))
    if path.suffix in SUFFIXES or path.suffixes[-2:] in ([".bag", ".active"],):
        return True
    if path.suffix in (*PACKED, *NOT_READ) and Path(path.stem).suffix in SUFFIXES:
        return True
    if holds_a_recording(path, SUFFIXES):
        return True
    if not path.is_file() or path.suffix in NO_RECORDING:
        return False
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
    except OSError:
        return False
    return head.startswith((MCAP_MAGIC, BAG_MAGIC))


def _of_recording(
    path: Path,
    name: str,
    events_topic: str | None,
    parts: tuple[Path, ...] = (),
    at_pauses: bool = True,
) -> list[TrialSpec]:
    """One trial per trial_start event; without any, the whole recording is one.

    at_pauses: or one between each two pauses of the recorder.
    """
    opened = open_container(path, parts)
    topic = events_topic or EVENTS_TOPIC
    marks: list[Event] = []
    if topic in opened.topics:
        for message in opened.messages(frozenset({topic})):
            try:
                event = read_event(opened.decode(message), message.log_ns)
            except (ValueError, UndecodableError):
                continue  # counted as undecodable when the trial is read
            if event.kind in (TRIAL_START_EVENT, TRIAL_END_EVENT):
                marks.append(event)
    marks = pressed_once(heard_once(marks))
    starts = [e.t_ns for e in marks if e.kind == TRIAL_START_EVENT]
    ends = [e.t_ns for e in marks if e.kind == TRIAL_END_EVENT]
    is_log_time = any(e.is_log_time for e in marks)
    if not starts:
        held = between_pauses(opened) if at_pauses and not ends else []
        if len(held) < 2:
            return [TrialSpec(name, path, parts=parts)]
        whole = TrialSpec(name, path, parts=parts, window_is_log_time=True, is_between_pauses=True)
        return [
            replace(whole, id=f"{name}#{k}", start_ns=start, end_ns=end)
            for k, (start, end) in enumerate(held)
        ]
    out = []
    for k, start in enumerate(sorted(starts)):
        later = sorted(t for t in [*starts, *ends] if t > start)
        # the end belongs to the trial; a next start does not
        end = later[0] if later and later[0] in ends else (later[0] - 1 if later else None)
        unique = name if len(starts) == 1 else f"{name}#{k}"
        out.append(TrialSpec(unique, path, start, end, parts=parts, window_is_log_time=is_log_time))
    return out


def _files_of(folder: Path, names: list[str]) -> tuple[Path, ...]:
    """The files of several recordings of a folder; those of a ROS 2 folder by what it holds."""
    given = [folder / name for name in names]
    held = [stored_files(p) if p.is_dir() else [p] for p in given]
    return tuple(file for files in held for file in files)


def _from_manifest(path: Path) -> list[TrialSpec]:
    values = read_toml(path)
    manifest = validated(_Manifest, values, "manifest", path)
    out = []
    for entry in manifest.trial:
        names = [entry.recording] if isinstance(entry.recording, str) else entry.recording
        recording, parts = path.parent / names[0], tuple[Path, ...]()
        if len(names) > 1:
            parts = _files_of(path.parent, names)
            recording = parts[0]
        name = entry.id or str(Path(names[0]).with_suffix(""))
        given = entry.model_dump(exclude={"recording", "id"})
        if entry.start_ns is None and entry.frames is None:
            for spec in _of_recording(recording, name, None, parts, at_pauses=False):
                times: dict[str, Any] = {
                    "start_ns": spec.start_ns,
                    "end_ns": entry.end_ns or spec.end_ns,
                    "window_is_log_time": spec.window_is_log_time and entry.end_ns is None,
                }
                out.append(TrialSpec(spec.id, recording, parts=parts, **{**given, **times}))
        else:
            out.append(TrialSpec(name, recording, parts=parts, **given))
    return out
