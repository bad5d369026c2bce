"""Catches: documentation that no longer says what the code does."""

from __future__ import annotations

import runpy
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def test_columns_page_is_made_from_the_schema() -> None:
    module = runpy.run_path(str(ROOT / "docs" / "make_columns.py"))
    assert (ROOT / "docs" / "columns.md").read_text(encoding="utf-8") == module["page"]()


def test_readme_names_only_what_exists() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in (
        "docs/review.jpg",
        "docs/report.png",
        "docs/columns.md",
        "docs/simulated.jpg",
        "datasets/demo.mcap",
    ):
        assert name in text
        assert (ROOT / name).is_file()


def test_committed_recordings_stay_small() -> None:
    assert (ROOT / "datasets" / "demo.mcap").stat().st_size < 3_000_000


def test_every_dependency_is_pinned_for_ci() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
    }
    for requirement in project["dependencies"]:
        name = (
            requirement.split(";")[0].split(">")[0].split("=")[0].strip().lower().replace("_", "-")
        )
        assert name in pins or name == "open3d", name


def test_the_example_of_the_api_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a page that names what is not there."""
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    code = page.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(ROOT)
    exec(compile(code, "docs/api.md", "exec"), {})
    assert capsys.readouterr().out.startswith("success ")
