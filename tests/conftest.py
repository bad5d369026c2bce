"""Shared fixtures: the demo recording, a replay of it, and the real recordings if available."""

from __future__ import annotations

import os
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DEMO = ROOT / "datasets" / "demo.mcap"

import dgeval.worlds  # noqa: E402  (chooses how images are drawn; a test module may import mujoco first)
from dgeval.determinism import set_thread_variables  # noqa: E402
from tests.commands import Commands  # noqa: E402

set_thread_variables()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files with the longest tests first, so that no process is left alone with one at the end.

    xdist keeps this order with --no-loadscope-reorder.
    """
    long = Counter(item.path for item in items if item.get_closest_marker("slow"))
    first = {"test_bundled.py": -2, "test_verdict.py": -1}
    items.sort(key=lambda item: (first.get(item.path.name, 0), -long[item.path]))


@pytest.fixture(scope="session")
def demo() -> Path:
    return DEMO


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; without it the tests that need it are skipped."""
    folder = os.environ.get("DGEVAL_REAL_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("DGEVAL_REAL_DATA does not name a folder with the real recordings")
    return Path(folder)


@pytest.fixture(scope="session")
def dgeval() -> Iterator[Callable[..., subprocess.CompletedProcess[str]]]:
    """Run the command line in a process of its own."""
    commands = Commands(ROOT)
    yield commands
    commands.close()


@pytest.fixture(scope="session")
def demo_run(
    demo: Path,
    dgeval: Callable[..., subprocess.CompletedProcess[str]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """A finished run of the demo recording, with its review."""
    out = tmp_path_factory.mktemp("run") / "demo"
    done = dgeval("replay", demo, "--out", out)
    assert done.returncode == 0, done.stderr
    return out
