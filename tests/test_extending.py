"""Catches: a hand, tracker, encoding or sub-cause that takes more than one file or one table row.

The files and the row that are added here are the code of docs/extending.md.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace as with_fields
from pathlib import Path
from types import ModuleType, SimpleNamespace

import mujoco
import pytest
from dgeval import failure_rule, plugins
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
from dgeval.robots.hand import hand_for, hand_of, hands
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.runs.workers import replay_trials
from dgeval.verdict.decide import Decision, Draw, Draws
from dgeval.verdict.outcome import Ended
from dgeval.verdict.sentence import Times, sentence
from dgeval.worlds.objects import ten_objects
from dgeval.worlds.scene import build
from mcap.writer import Writer

PAGE = Path(__file__).resolve().parents[1] / "docs" / "extending.md"
ADDED = (
    "dgeval.robots.claw",
    "dgeval.perception.trackers.fixed_box",
    "dgeval.recording.encodings.text",
)


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
    for name in ADDED:
        sys.modules.pop(name, None)


def test_a_hand_is_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Found for its joints, built in a world, and closed there.

    Catches an example whose grip, drives or description name joints that the hand does not have,
    and one that takes another hand's place.
    """
    added(monkeypatch, "dgeval.robots", tmp_path, "claw.py")
    hand = hand_of({"claw_left", "claw_right", "arm_1"})
    assert hand is not None
    assert hand.name == "claw"
    model = build(ten_objects()["apple"], robot="hand", gripper=hand)
    assert {model.joint(j).name for j in hand.joints} == {"claw_left", "claw_right"}
    assert set(hand.grip.joints) <= set(hand.joints)
    description = load_description(robot_urdf(hand.T_hand_camera, hand), hand.name, (), 0.01)
    assert {j.name for j in description.joints.values()} >= set(hand.joints)
    assert hand_for("vfas").name == "parallel_jaw"

    data = mujoco.MjData(model)
    places = [model.jnt_qposadr[model.joint(j).id] for j in hand.joints]
    data.qpos[places] = hand.open
    while data.time < hand.close_s:
        for drive, target in zip(hand.drives, hand.targets(data.time, hand.open), strict=True):
            data.actuator(drive).ctrl = target
        mujoco.mj_step(model, data)
    assert (data.qpos[places] < 0.002).all()  # m of travel left, of 50 mm


def test_a_tracker_is_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, demo: Path) -> None:
    """It gives the boxes of a replay, and its name stands in the trial's notes."""
    added(monkeypatch, "dgeval.perception.trackers", tmp_path, "fixed_box.py")
    config = load_config("dynamic", ("tracking.method=fixed_box",))
    trial = open_trial(find_trials([demo])[0], config)
    rows = [step.row for step, _ in zip(replay(trial, config), range(3), strict=False)]
    tracked = [r for r in rows if r["tracking"] == "tracked"]
    assert tracked
    assert {r["box_x0"] for r in tracked} == {10.0}
    spec = with_fields(find_trials([demo])[0], frames=(0, 3))
    results = replay_trials([spec], config, tmp_path / "run", None, False, 1, lambda _: None)
    row = results[0].row
    assert row is not None, results[0].messages
    assert row["n_frames"] == 3
    assert "stand-in: a fixed box in place of TransT-M" in row["notes"]


def test_without_its_file_a_tracker_is_refused() -> None:
    """Catches a test above that would pass with a tracker that is left over."""
    with pytest.raises(UsageError, match="there are csrt, model"):
        load_config("dynamic", ("tracking.method=fixed_box",))


def test_a_tracker_that_is_not_there_is_named_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="did you mean 'csrt'"):
        tracker_named("crst")


def test_an_encoding_is_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A recording in it is read: its events are found, and were not before."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "plain", b"")
        channel = writer.register_channel("/dgeval/events", "text", schema)
        for t_ns, data in ((10, b'{"event": "close"}'), (20, b'{"event": "lift"}')):
            writer.add_message(channel, t_ns, data, t_ns)
        writer.finish()
    config = load_config("dynamic", ())
    before = inspect_recording(path, config)
    assert before["events"] == []
    assert before["topics"][0]["undecodable"] == 2
    decoders.cache_clear()
    added(monkeypatch, "dgeval.recording.encodings", tmp_path, "text.py")
    after = inspect_recording(path, config)
    assert [e["event"] for e in after["events"]] == ["close", "lift"]
    assert "undecodable" not in after["topics"][0]
    assert after["damage"] == []


@pytest.mark.parametrize(
    ("group", "name", "find", "key"),
    [
        ("dgeval.hands", "claw.py", lambda: [h.name for h in hands()], "claw"),
        ("dgeval.trackers", "fixed_box.py", lambda: list(trackers()), "fixed_box"),
        ("dgeval.encodings", "text.py", lambda: list(decoders()), ("text", "plain")),
    ],
)
def test_an_entry_point_names_a_module(
    group: str,
    name: str,
    find: Callable[[], list[object]],
    key: object,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches a group whose name is not the page's, and an installed package that is not found."""
    module = ModuleType("installed")
    exec(blocks()[name], module.__dict__)
    assert f"`{group}`" in PAGE.read_text(encoding="utf-8")

    entry = SimpleNamespace(name="installed", value="installed", dist=None, load=lambda: module)
    asked: list[str] = []

    def installed(group: str) -> list[SimpleNamespace]:
        asked.append(group)
        return [entry]

    monkeypatch.setattr(plugins, "entry_points", installed)
    assert key in find()
    assert asked == [group]


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
        "yuv",
        "bayer",
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
