"""Catches: a hand, tracker, encoding or sub-cause that takes more than one file or one table row.

The files and the row that are added here are the code of docs/extending.md.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from dgeval import failure_rule
from dgeval.config import load_config
from dgeval.errors import UsageError
from dgeval.failure_rule import Facts, SubCause, Verdict, classify
from dgeval.perception.trackers import tracker_named, trackers
from dgeval.recording.encodings import decoders
from dgeval.recording.image_codecs import codecs
from dgeval.recording.inspection import inspect_recording
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from dgeval.replay.causal import replay
from dgeval.robots.hand import hand_of, hands
from dgeval.verdict.decide import Decision, Draw, Draws
from dgeval.verdict.outcome import Ended
from dgeval.verdict.sentence import Times, sentence
from dgeval.worlds.objects import ten_objects
from dgeval.worlds.scene import build
from mcap.writer import Writer

PAGE = Path(__file__).resolve().parents[1] / "docs" / "extending.md"


def blocks() -> dict[str, str]:
    """Python blocks of the page by the file name in their first comment."""
    found = re.findall(r"```python\n# (\S+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return dict(found)


def added(monkeypatch: pytest.MonkeyPatch, package: str, folder: Path, name: str) -> None:
    """The page's file put into a package, as if it lay in its folder."""
    (folder / name).write_text(blocks()[name])
    module = sys.modules[package]
    monkeypatch.setattr(module, "__path__", [*module.__path__, str(folder)])


@pytest.fixture(autouse=True)
def forget() -> Iterator[None]:
    """What was found is looked for again, before and after."""
    for cached in (hands, trackers, decoders, codecs):
        cached.cache_clear()
    yield
    for cached in (hands, trackers, decoders, codecs):
        cached.cache_clear()
    for name in [n for n in sys.modules if n.rsplit(".", 1)[-1] in ("claw", "fixed_box", "text")]:
        del sys.modules[name]


def test_a_hand_is_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Found for its joints, and built in a world."""
    added(monkeypatch, "dgeval.robots", tmp_path, "claw.py")
    hand = hand_of({"claw_left", "claw_right", "arm_1"})
    assert hand is not None
    assert hand.name == "claw"
    model = build(ten_objects()["apple"], robot="hand", gripper=hand)
    assert model.joint("claw_left").name == "claw_left"


def test_a_tracker_is_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, demo: Path) -> None:
    """It gives the boxes of a replay."""
    added(monkeypatch, "dgeval.perception.trackers", tmp_path, "fixed_box.py")
    config = load_config("dynamic", ("tracking.method=fixed_box",))
    trial = open_trial(find_trials([demo])[0], config)
    rows = [step.row for step, _ in zip(replay(trial, config), range(3), strict=False)]
    tracked = [r for r in rows if r["tracking"] == "tracked"]
    assert tracked
    assert {r["box_x0"] for r in tracked} == {10.0}


def test_a_tracker_that_is_not_there_is_named_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="did you mean 'csrt'"):
        tracker_named("crst")


def test_an_encoding_is_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A recording in it is read: its events are found."""
    added(monkeypatch, "dgeval.recording.encodings", tmp_path, "text.py")
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "plain", b"")
        channel = writer.register_channel("/dgeval/events", "text", schema)
        for t_ns, data in ((10, b'{"event": "close"}'), (20, b'{"event": "lift"}')):
            writer.add_message(channel, t_ns, data, t_ns)
        writer.finish()
    events = inspect_recording(path, load_config("dynamic", ()))["events"]
    assert [e["event"] for e in events] == ["close", "lift"]


def test_a_sub_cause_is_one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """It comes out of the rule, and its sentence out of the verdict."""
    space: dict[str, SubCause] = {}
    exec(blocks()["row"], {"SubCause": SubCause}, space)
    monkeypatch.setattr(failure_rule, "SUB_CAUSES", (space["ROW"], *failure_rule.SUB_CAUSES))
    facts = Facts(True, 0.006, 0.0, ((-0.3, False),), None, 0.0, put_back=True)
    answer = classify(facts)
    assert isinstance(answer, Verdict)
    assert (answer.failure_class, answer.sub_cause) == ("collision", "grazed")
    decision = Decision(
        answer,
        (0.05, 0.9, 0.05, 0.0),
        Draws((Draw(answer, facts, True, 1.0, {}, None, "claw_1"),), 1.0, "twin"),
    )
    said = sentence(
        Times(0, 2 * 10**9, 10**9, None), Ended("failure", None, "it fell"), decision, "claw_1"
    )
    assert said.endswith("claw_1 grazed the object by 6 mm")


def test_a_pixel_format_is_found_in_its_folder() -> None:
    """Catches an order that depends on file names: raw images are asked first."""
    assert [m.__name__.rsplit(".", 1)[-1] for m in codecs()] == [
        "raw",
        "compressed_depth",
        "compressed",
    ]


def test_the_page_counts_its_lines() -> None:
    """The table's number of lines is that of the code."""
    page = PAGE.read_text(encoding="utf-8")
    for name, code in blocks().items():
        n = len([line for line in code.splitlines() if line.strip()])
        assert f"| {n} |" in next(
            line for line in page.splitlines() if f"`{name}`" in line and "|" in line
        ), name
