"""Catches: an unknown key that is accepted, and a file that wins over the command line."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from dgeval.config import load_config
from dgeval.errors import UsageError
from dgeval.planning.execution import PAPER_C_E


def test_a_handover_has_values_of_its_own() -> None:
    """Fails where a handover is replayed as a belt, or a person's word for a value is not kept."""
    given = load_config("dynamic", ("pipeline=dynamic",))
    assert given.of_scenario("handover").estimation.loss_policy == "constant_velocity", "as given"
    config = load_config("handover")
    assert (config.pipeline, config.estimation.loss_policy) == ("handover", "zero")
    assert config.estimation.sigma_acceleration == 1.0
    belt = load_config("dynamic", ("estimation.sigma_acceleration=0.5",))
    assert belt.of_scenario("conveyor") == belt.of_scenario(None) == belt
    again = pickle.loads(pickle.dumps(belt))  # as a worker gets it
    for one in (belt, again):
        held_out = one.of_scenario("handover")
        assert held_out.pipeline == "handover"
        assert held_out.estimation.loss_policy == "zero"
        assert held_out.estimation.sigma_acceleration == 0.5, "as given"
    assert load_config("vfas").of_scenario("handover").pipeline == "vfas"
    with pytest.raises(UsageError, match="c_O must be larger than c_G"):
        load_config("dynamic", ("servo.c_O=0.05",))
    with pytest.raises(UsageError, match="no pipeline 'belt'"):
        load_config("belt")


def test_defaults_are_the_papers_table_v() -> None:
    c = load_config()
    assert (
        c.observation.c_z,
        c.registration.c_a_f,
        c.registration.c_a_v,
        c.registration.c_a_w,
    ) == (0.1, 0.8, 4.0, 4.0)
    assert (c.fusion.n_s, c.fusion.epsilon, PAPER_C_E) == (5, 0.01, 0.7)
    assert (c.selection.c_m_s, c.selection.c_m_t, c.selection.c_m_r) == (1.0, -0.1, -0.2)
    assert (
        c.servo.c_O,
        c.servo.c_G,
        c.servo.c_p_v,
        c.servo.c_d_v,
        c.servo.c_p_w,
        c.servo.c_d_w,
    ) == (0.2, 0.05, 1, 2, 2.5, 5)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("fusion.epsilom=0.02", "did you mean fusion.epsilon?"),
        ("fuson.epsilon=0.02", "did you mean fusion?"),
        ("fusion.epsilon=wide", "fusion.epsilon"),
        ("fusion.epsilon=-1", "greater than 0"),
        ("fusion.epsilon", "section.key=value"),
        ("seed.x=1", "seed"),
        ("tracking.method=modle", "did you mean 'model'? (got 'modle')"),
        ("tracking.method=x", "there are csrt, model"),
    ],
)
def test_mistakes_are_named(assignment: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_config("dynamic", (assignment,))
    assert message in str(caught.value)


def test_command_line_wins_over_file_over_default(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'seed = 3\n[registration]\nmethod = "open3d"\n[fusion]\nn_s = 4\n', encoding="utf-8"
    )
    c = load_config(str(file), ("fusion.n_s=2",))
    assert (c.seed, c.registration.method, c.fusion.n_s, c.fusion.epsilon) == (3, "open3d", 2, 0.01)


def test_environment_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SEED", "DGEVAL_SEED", "fusion__n_s", "FUSION"):
        monkeypatch.setenv(name, "9")
    assert load_config() == load_config()
    assert load_config().seed == 0


@pytest.mark.parametrize("text", ["[fusion", "\x00", "fusion = 3"])
def test_broken_files_are_usage_errors(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError):
        load_config(str(file))


def test_unknown_pipeline_is_named() -> None:
    with pytest.raises(UsageError, match="vfa"):
        load_config("vfa")
