"""Result files: Markdown tables under the command, version and platform that made them."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from pathlib import Path

import dgeval
import numpy as np

RESULTS = Path(__file__).parent / "results"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def number(value: float | None, digits: int = 1) -> str:
    """A number for a table; – where it is None or not finite."""
    return "–" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"


def write(
    name: str, title: str, command: str, parts: Sequence[str], folder: Path = RESULTS
) -> Path:
    """Write results/NAME.md: title, the command and version that made it, the parts."""
    origin = (
        f"Made by `{command}` with dgeval {dgeval.__version__} (sources {source_digest()}) on "
        f"{processor()}."
    )
    path = folder / f"{name}.md"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join([f"# {title}", origin, *parts]) + "\n", encoding="utf-8")
    return path


def source_digest() -> str:
    """First 12 hex digits of the SHA-256 over dgeval's Python files in name order."""
    digest = hashlib.sha256()
    root = Path(dgeval.__file__).parent
    for file in sorted(root.rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:12]


def processor() -> str:
    """Name of the processor (Linux) or its architecture, and the version of Python."""
    name = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [
            line.split(":", 1)[1].strip()
            for line in info.read_text().splitlines()
            if line.startswith("model name")
        ]
        name = models[0] if models else name
    return f"{name}, Python {platform.python_version()}"
