"""Write docs/columns.md from the tables in dgeval/schema.py; a test compares the two."""

from __future__ import annotations

from pathlib import Path

from dgeval.schema import FRAMES, FRAMES_ADDED, HINDSIGHT, SCHEMA_VERSION, TIMINGS, TRIALS, Column


def page() -> str:
    """The page as Markdown."""
    parts = [
        "# Columns of the result tables",
        "",
        f"Schema version {SCHEMA_VERSION}. Made by `python docs/make_columns.py`; do not edit by "
        "hand.",
        "Poses are px py pz qx qy qz qw. `T_a_b` maps points from frame b into frame a. Nothing to "
        "say is null, not NaN.",
        "Digests are taken per stage over the version-1 columns of `frames`.",
    ]
    tables: tuple[tuple[str, tuple[Column, ...]], ...] = (
        ("frames/<trial>.parquet, one row per paired frame", FRAMES),
        ("frames, added since (in no digest)", FRAMES_ADDED),
        ("hindsight/<trial>.parquet, one row per frame around a grasp attempt", HINDSIGHT),
        ("trials.parquet", TRIALS),
        ("timings.parquet", TIMINGS),
    )
    for title, columns in tables:
        parts += [
            "",
            f"## {title}",
            "",
            "| column | type | unit | stage | meaning |",
            "|---|---|---|---|---|",
        ]
        parts += [
            f"| `{c.name}` | {c.kind} | {c.unit or '–'} | {c.stage} | {c.meaning} |"
            for c in columns
        ]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "columns.md").write_text(page(), encoding="utf-8")
