"""Catches: a page on recording whose examples do not run, or a check that it does not list."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from dgeval.recording.check import PART_CHECK
from dgeval.recording.manifest import find_trials
from dgeval.recording.messages import event_of

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")


def block(kind: str) -> str:
    (text,) = re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)
    return str(text)


def test_the_node_writes_what_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ROS types are stood in for; what is published is read by dgeval."""
    messages = ModuleType("std_msgs.msg")
    messages.String = lambda data: SimpleNamespace(data=data)  # type: ignore[attr-defined]
    package = ModuleType("std_msgs")
    monkeypatch.setitem(__import__("sys").modules, "std_msgs", package)
    monkeypatch.setitem(__import__("sys").modules, "std_msgs.msg", messages)
    said: list[Any] = []
    now = SimpleNamespace(nanoseconds=123)
    node = SimpleNamespace(
        create_publisher=lambda *_: SimpleNamespace(publish=said.append),
        get_clock=lambda: SimpleNamespace(now=lambda: now),
    )
    names: dict[str, Any] = {}
    exec(block("python"), names)
    marks = names["Marks"](node)
    for line in re.findall(r"marks\.mark\(.*?\)", block("python")):
        eval(line, {"marks": marks})
    events = [event_of(m.data, 999) for m in said]
    assert [e.kind for e in events] == ["trial_start", "close", "lift", "trial_end", "label"]
    assert {e.t_ns for e in events} == {123}
    assert events[-1].fields == {"label": "failure"}


def test_the_words_of_the_command_line_are_understood() -> None:
    words = re.findall(r'"\{data: (\w+)\}"', PAGE)
    assert len(words) == 2
    for word in words:
        event_of(word, 1)


def test_the_manifest_is_one(tmp_path: Path, demo: Path) -> None:
    (tmp_path / "apple.mcap").symlink_to(demo)
    (tmp_path / "m.toml").write_text(block("toml"), encoding="utf-8")
    (spec,) = find_trials([tmp_path / "m.toml"])
    assert (spec.close_ns, spec.lift_ns, spec.label) == (
        1800000003200000000,
        1800000004000000000,
        "failure",
    )


def test_every_check_is_listed() -> None:
    code = "".join(
        (ROOT / "dgeval" / name).read_text(encoding="utf-8")
        for name in (
            "recording/checks.py",
            "recording/frame_checks.py",
            "recording/stamp_checks.py",
            "runs/target_told.py",
        )
    )
    made = {*re.findall(r'(?:(?:Check|_Told)\(\s*|return )"(\w+)", ', code), PART_CHECK}
    listed = set(re.findall(r"^\| `(\w+)` \|", PAGE.split("# Checks")[1], re.MULTILINE))
    assert made == listed
