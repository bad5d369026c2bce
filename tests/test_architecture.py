"""Catches: a page of the architecture that names a file, function or package that is not there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
WALK = PAGE.split("## From `dgeval replay`")[1]


def test_files_and_functions_of_the_walk_exist() -> None:
    files = [ROOT / name for name in re.findall(r"`(dgeval/[\w/]+\.py)`", WALK)]
    assert len(files) >= 10
    code = "\n".join(f.read_text(encoding="utf-8") for f in files)
    names = [n for n in re.findall(r"`(\w+)`", WALK) if n not in ("dgeval",)]
    for name in names:
        assert re.search(rf"^(def|class) {name}\b|^{name}\b", code, re.MULTILINE), name


def test_a_function_stands_in_the_file_it_is_named_with() -> None:
    """Catches a walk that sends the reader to the wrong file."""
    pairs = re.findall(r"`(\w+)`\s+(?:\w+\s+)?in\s+`(dgeval/[\w/]+\.py)`", WALK)
    assert len(pairs) >= 9
    for name, file in pairs:
        code = (ROOT / file).read_text(encoding="utf-8")
        assert re.search(rf"^(def|class) {name}\b|^{name}\b", code, re.MULTILINE), (name, file)


def test_every_package_is_described() -> None:
    for path in sorted((ROOT / "dgeval").iterdir()):
        if path.name.startswith("_") or path.suffix not in ("", ".py"):
            continue
        name = path.name if path.name != "api.py" else "api"
        assert f"`{name}`" in PAGE, name


def test_the_walk_is_read_in_a_minute() -> None:
    """At 230 words a minute."""
    assert len(WALK.split()) < 230


def test_no_verdict_reads_a_truth_topic_or_imports_by_name() -> None:
    """Catches the two ways to the truth that import-linter does not see."""
    for package in ("verdict", "hindsight", "replay", "planning", "perception"):
        for path in sorted((ROOT / "dgeval" / package).rglob("*.py")):
            code = path.read_text(encoding="utf-8")
            assert "TRUTH_" not in code, path
            assert "/truth" not in code, path
            assert "import_module" not in code, path
            assert "__import__" not in code, path


@pytest.mark.slow
def test_a_replay_that_asks_no_network_does_not_load_torch(demo: Path, tmp_path: Path) -> None:
    """Catches an import at the top of a module that costs every command seconds.

    Trackers and other parts are found by loading every file of their folder, so only a whole run
    shows it.
    """
    code = (
        "import sys, dgeval.cli\n"
        f"sys.argv = ['dgeval', 'replay', {str(demo)!r}, '--frames', '0:5', '--no-review',"
        f" '--out', {str(tmp_path / 'run')!r}]\n"
        "try:\n    dgeval.cli.main()\nexcept SystemExit as end:\n    assert not end.code\n"
        "print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "False"
