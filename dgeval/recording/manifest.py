"""The trials that paths and manifests name: which part of which recording, and its metadata."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, field_validator

from dgeval.config import read_toml, validated
from dgeval.errors import Place, UndecodableError, UnreadableError, UsageError
from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import (
    EVENTS_TOPIC,
    FAILURE_LABELS,
    SUCCESS_LABELS,
    TRIAL_END_EVENT,
    TRIAL_START_EVENT,
    label_of,
)

SUFFIXES = (".mcap", ".bag", ".db3")


class _ManifestTrial(BaseModel):
    model_config = ConfigDict(extra="forbid")
    id: str | None = None
    recording: str
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
    close_ns, lift_ns: of the commands, where a person knows better than the log. sha256: of the
    recording, as the manifest says.
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


def find_trials(paths: list[Path], events_topic: str | None = None) -> list[TrialSpec]:
    """Trials of recordings, folders of recordings and manifests, with unique ids.

    UsageError, UnreadableError.
    """
    specs: list[TrialSpec] = []
    for path in paths:
        if path.suffix == ".toml":
            specs.extend(_from_manifest(path))
        elif path.is_dir() and not _is_recording(path):
            inside = sorted(
                p for p in path.rglob("*") if _is_recording(p) and not _is_recording(p.parent)
            )
            if not inside:
                raise UnreadableError(
                    "no recording (.mcap, .bag, .db3) below this folder", Place(str(path))
                )
            for file in inside:
                relative = file.relative_to(path)
                specs.extend(
                    _of_recording(
                        file,
                        str(relative.with_suffix("") if file.is_file() else relative),
                        events_topic,
                    )
                )
        else:
            specs.extend(
                _of_recording(
                    path, path.stem if path.suffix in SUFFIXES else path.name, events_topic
                )
            )
    ids = [s.id for s in specs]
    twice = sorted({i for i in ids if ids.count(i) > 1})
    if twice:
        raise UsageError(
            f"trial ids are not unique: {', '.join(twice)}",
            hint="give a manifest with an id per trial",
        )
    return specs


def _is_recording(path: Path) -> bool:
    """Whether a path is a recording: a file by its suffix, or a ROS 2 folder with metadata.yaml.

    In a folder without metadata each file is a recording of its own.
    """
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and any(
            p.suffix in (".mcap", ".db3") for p in path.iterdir()
        )
    return path.suffix in SUFFIXES


def _of_recording(path: Path, name: str, events_topic: str | None) -> list[TrialSpec]:
    """One trial per trial_start event; without any, the whole recording is one."""
    opened = open_container(path)
    topic = events_topic or EVENTS_TOPIC
    starts: list[int] = []
    ends: list[int] = []
    if topic in opened.topics:
        from dgeval.recording.messages import event_of

        for message in opened.messages(frozenset({topic})):
            try:
                event = event_of(opened.decode(message).data, message.log_ns)
            except (ValueError, UndecodableError):
                continue  # counted as undecodable when the trial is read
            if event.kind in (TRIAL_START_EVENT, TRIAL_END_EVENT):
                (starts if event.kind == TRIAL_START_EVENT else ends).append(event.t_ns)
    if not starts:
        return [TrialSpec(name, path)]
    out = []
    for k, start in enumerate(sorted(starts)):
        later = sorted(t for t in [*starts, *ends] if t > start)
        # the end belongs to the trial; a next start does not
        end = later[0] if later and later[0] in ends else (later[0] - 1 if later else None)
        out.append(TrialSpec(name if len(starts) == 1 else f"{name}#{k}", path, start, end))
    return out


def _from_manifest(path: Path) -> list[TrialSpec]:
    values = read_toml(path)
    manifest = validated(_Manifest, values, "manifest", path)
    out = []
    for entry in manifest.trial:
        recording = path.parent / entry.recording
        given = entry.model_dump(exclude={"recording", "id"})
        if entry.start_ns is None and entry.frames is None:
            for spec in _of_recording(
                recording, entry.id or str(Path(entry.recording).with_suffix("")), None
            ):
                times = {"start_ns": spec.start_ns, "end_ns": entry.end_ns or spec.end_ns}
                out.append(TrialSpec(spec.id, recording, **{**given, **times}))
        else:
            out.append(
                TrialSpec(
                    entry.id or str(Path(entry.recording).with_suffix("")), recording, **given
                )
            )
    return out
