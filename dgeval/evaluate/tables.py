"""The tables of the papers' experiments: own results with intervals beside the printed counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from dgeval.compare.paired import mcnemar
from dgeval.evaluate.experiments import Results
from dgeval.failure_rule import CLASSES
from dgeval.report.summary import LABELS, published
from dgeval.statistics import wilson

Trial = dict[str, Any]


@dataclass(frozen=True)
class Count:
    """k of n; n = 0 is an empty cell."""

    k: int
    n: int

    @property
    def text(self) -> str:
        """With its share and its Wilson 95 % interval, %."""
        if not self.n:
            return "–"
        low, high = wilson(self.k, self.n)
        return f"{self.k}/{self.n} = {self.k / self.n:.0%} [{100 * low:.0f}–{100 * high:.0f}]"

    @property
    def printed(self) -> str:
        """As a paper's count, without an interval."""
        return f"{self.k}/{self.n} = {self.k / self.n:.0%}" if self.n else "–"

    def document(self, is_own: bool) -> dict[str, Any]:
        """For JSON; a paper's count has no interval."""
        interval = {"interval": list(wilson(self.k, self.n))} if is_own else {}
        return {"k": self.k, "n": self.n, **interval}

    def plus(self, other: Count) -> Count:
        return Count(self.k + other.k, self.n + other.n)


@dataclass(frozen=True)
class Table:
    """title, names of the columns, and rows: a name and its counts, own and printed in turn."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Count, ...]], ...]

    @property
    def _heads(self) -> list[tuple[int, str]]:
        """Index and name of the columns that hold anything."""
        names = [name for c in self.columns for name in (c, f"{c}, paper")]
        shown = [k % 2 == 0 or any(row[1][k].n for row in self.rows) for k in range(len(names))]
        return [(k, name) for k, name in enumerate(names) if shown[k]]

    def markdown(self) -> str:
        head = ["", *(name for _, name in self._heads)]
        lines = [f"**{self.title}**", "", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
        for name, counts in self.rows:
            cells = [counts[k].printed if k % 2 else counts[k].text for k, _ in self._heads]
            lines.append("| " + " | ".join([name, *cells]) + " |")
        return "\n".join(lines)

    def document(self) -> dict[str, Any]:
        """For JSON."""
        rows = [
            {"name": name, **{head: counts[k].document(k % 2 == 0) for k, head in self._heads}}
            for name, counts in self.rows
        ]
        return {"title": self.title, "rows": rows}


def tables_of(suite: str, results: Sequence[Results]) -> list[Table]:
    """The tables of a suite's paper."""
    if suite == "paper-dynamic":
        conveyor, handover = results
        return [
            _by_speed("Success by belt speed (Table II)", [conveyor], ["conveyor"]),
            _by_object("Success by object (Table III)", results, ["conveyor", "handover"], True),
            *_failures(results, " (Table IV)"),
        ]
    static, turntable, handover = results[:2], results[2:4], results[4]
    arms = ["without", "with"]
    return [
        _by_object("Table clearing, seed as given and VFAS (Table I)", static, arms, False),
        _by_speed("Turntable, without and with adaptive sampling (Table II)", turntable, arms),
        Table(
            "Handover", ("VFAS",), (("all", (success(handover.trials), Count(77, 96))),)
        ),
        *_failures(results),
    ]  # fmt: skip


def paired_notes(suite: str, results: Sequence[Results]) -> list[str]:
    """Sentences on two arms of the same trials."""
    if suite != "paper-vfas":
        return []
    out = []
    for before, after in (results[:2], results[2:4]):
        old, new = ({i: _held(t) for i, t in zip(r.ids, r.trials, strict=True)}
                    for r in (before, after))  # fmt: skip
        both = sorted(set(old) & set(new))
        lost, gained, p = mcnemar([old[i] for i in both], [new[i] for i in both])
        out.append(
            f"{before.arm.name} to {after.arm.name}, the same {len(both)} trials: {gained} gained, "
            f"{lost} lost, exact McNemar p = {p:.2g}"
        )
    return out


def success(trials: Sequence[Trial]) -> Count:
    """Held at the end, of all trials, as the papers count."""
    return Count(sum(_held(t) for t in trials), len(trials))


def _held(trial: Trial) -> bool:
    return bool(trial["outcome"] == "success")


def _by_speed(title: str, results: Sequence[Results], arms: Sequence[str]) -> Table:
    return _by(
        title, results, arms, lambda t: str(round(1000 * abs(t["speed"]))), "speed_mm_s", " mm/s"
    )


def _by_object(
    title: str, results: Sequence[Results], arms: Sequence[str], combined: bool
) -> Table:
    table = _by(title, results, arms, lambda t: str(t["object"]), "object", "")
    if not combined:
        return table
    rows = []
    for name, counts in table.rows:
        own, paper = counts[0].plus(counts[2]), counts[1].plus(counts[3])
        rows.append((name, (*counts, own, paper)))
    return Table(title, (*table.columns, "both"), tuple(rows))


def _by(
    title: str,
    results: Sequence[Results],
    arms: Sequence[str],
    key: Callable[[Trial], str],
    section: str,
    unit: str,
) -> Table:
    """One row for each value of a key, and one for all; a pair of columns for each arm."""
    names = list(dict.fromkeys(key(t) for r in results for t in r.trials))
    if unit:
        names.sort(key=int)
    printed = [_printed(r, section, arm) for r, arm in zip(results, arms, strict=True)]
    rows = []
    for name in [*names, None]:
        counts: list[Count] = []
        for result, (by_name, n) in zip(results, printed, strict=True):
            own = [t for t in result.trials if name is None or key(t) == name]
            given = by_name.values() if name is None else [by_name.get(name)]
            known = [k for k in given if k is not None]
            counts += [success(own), Count(sum(known), n * len(known))]
        rows.append(("all" if name is None else f"{name}{unit}", tuple(counts)))
    return Table(title, tuple(arms), tuple(rows))


def _printed(result: Results, section: str, arm: str) -> tuple[dict[str, int], int]:
    """The paper's counts by name, and of how many trials each is."""
    table = published().get(result.arm.scenario, {})
    n = table.get("n_per_speed" if section == "speed_mm_s" else "n_per_object", 0)
    return table.get("without" if arm == "without" else section, {}), n


def _failures(results: Sequence[Results], of_paper: str = "") -> list[Table]:
    """Shares of the failures' classes: as seen, beside the paper, and by what had to differ."""
    out = []
    for column, title in (
        ("observed_class", "Failures as a person at the video would write"),
        ("failure_class", "Failures by what would have had to be different"),
    ):
        rows = []
        for c in CLASSES:
            counts: list[Count] = []
            for result in results:
                failed = [t for t in result.trials if t["outcome"] == "failure"]
                own = Count(sum(t.get(column) == c for t in failed), len(failed))
                given = published().get(result.arm.scenario, {}).get("failures", {})
                is_beside = column == "observed_class" and given
                paper = Count(given[c], sum(given.values())) if is_beside else Count(0, 0)
                counts += [own, paper]
            rows.append((LABELS[c], tuple(counts)))
        title += of_paper if column == "observed_class" else ""
        out.append(Table(title, tuple(r.arm.name for r in results), tuple(rows)))
    if len(results) == 2:
        seen = out[0]
        both = tuple((name, (*c, c[0].plus(c[2]), c[1].plus(c[3]))) for name, c in seen.rows)
        out[0] = Table(seen.title, (*seen.columns, "both"), both)
    return out
