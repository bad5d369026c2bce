"""What verdicts say beside what is so: by a simulator's truth, or by people's words.

Every failure counts: a class that is not given, an outcome that is wrong and a recording that is
refused are misses of the trial's class.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgeval.determinism import generator
from dgeval.errors import EXIT_DATA_LOST
from dgeval.failure_rule import CLASSES
from dgeval.geometry import Array
from dgeval.report.summary import LABELLED, LABELS
from dgeval.statistics import calibration_error, confusion, macro_f1, wilson

ALL = "all"
NOT_REPLAYED, NO_FAILURE = "not replayed", "no failure"
SAID = (*CLASSES, "unknown", NO_FAILURE, NOT_REPLAYED)
ENDS = ("success", "failure", "no_grasp", "incomplete", "unknown", NOT_REPLAYED)
PERFECT = 400  # draws of a verdict that is right as often as it says; ours
CLOSE_S = 0.05  # s; a close found so near to the true one is right; ours


@dataclass(frozen=True)
class Judged:
    """One trial. arm, condition: what it is a trial of, and what its log holds. said: its row of
    the table of trials; None where it could not be replayed. true: outcome, failure_class,
    observed_class, sub_cause, t_close_ns, as far as they are known. messages, exit_code: of its
    replay. marks: what else is to be known of the truth.
    """

    trial: str
    arm: str
    said: Mapping[str, Any] | None
    true: Mapping[str, Any]
    messages: tuple[str, ...] = ()
    exit_code: int = 0
    marks: tuple[str, ...] = ()
    condition: str = ""

    @property
    def outcome(self) -> str:
        """As the verdict says it."""
        return NOT_REPLAYED if self.said is None else str(self.said["outcome"])

    def label(self, column: str) -> str:
        """The class that is said, or why there is none: one of SAID."""
        if self.said is None:
            return NOT_REPLAYED
        return str(self.said[column]) if self.outcome == "failure" else NO_FAILURE

    def chances(self, column: str) -> tuple[float, ...] | None:
        """The stated shares (3,) of the classes; None where no class was asked for."""
        if self.said is None or self.outcome != "failure":
            return None
        prefix = "p_" if column == "failure_class" else "p_observed_"
        values = [self.said.get(prefix + c) for c in CLASSES]
        return None if any(v is None for v in values) else tuple(float(v or 0.0) for v in values)


def groups_of(trials: Sequence[Judged]) -> list[tuple[str, list[Judged]]]:
    """The trials by arm and condition, and those of all arms by condition where there are several;
    each with its name.
    """
    arms = list(dict.fromkeys(t.arm for t in trials))
    conditions = list(dict.fromkeys(t.condition for t in trials))
    out = []
    for arm in [*arms, *([ALL] if len(arms) > 1 else [])]:
        for condition in conditions:
            chosen = [t for t in trials if arm in (t.arm, ALL) and t.condition == condition]
            if chosen:
                out.append((", ".join(filter(None, [arm, condition])), chosen))
    return out


def document_of(trials: Sequence[Judged]) -> dict[str, Any]:
    """All figures of a set of trials, for JSON; shares with Wilson 95 % intervals."""
    failed = [t for t in trials if t.true.get("outcome") == "failure"]
    ends = [t for t in trials if t.true.get("outcome") is not None]
    out: dict[str, Any] = {"trials": len(trials), "failures": len(failed)}
    if ends:
        out["outcome"] = {
            "right": _share(sum(t.outcome == t.true["outcome"] for t in ends), len(ends)),
            "said": _matrix(
                [str(t.true["outcome"]) for t in ends], [t.outcome for t in ends], ENDS
            ),
        }
    out["labels"] = {
        column: _label(column, [t for t in failed if t.true.get(column)])
        for column in LABELLED
        if any(t.true.get(column) for t in failed)
    }
    out["closes"] = _closes(trials)
    sub = [
        t
        for t in failed
        if t.true.get("sub_cause") and t.label("failure_class") == t.true.get("failure_class")
    ]
    if sub:
        right = sum(t.said is not None and t.said["sub_cause"] == t.true["sub_cause"] for t in sub)
        out["sub_cause"] = _share(right, len(sub))
    out["exit_codes"] = {str(k): n for k, n in sorted(Counter(t.exit_code for t in trials).items())}
    return out


def _share(k: int, n: int) -> dict[str, Any]:
    return {"k": k, "n": n, "interval": list(wilson(k, n))}


def _matrix(true: list[str], said: list[str], names: tuple[str, ...]) -> dict[str, dict[str, int]]:
    """By what is so, how often each was said; names that occur nowhere are left out."""
    counts = confusion(true, said, names)
    columns = [k for k in range(len(names)) if counts[:, k].any()]
    return {
        name: {names[k]: int(row[k]) for k in columns}
        for name, row in zip(names, counts, strict=True)
        if row.any()
    }


def _label(column: str, failed: Sequence[Judged]) -> dict[str, Any]:
    true = [str(t.true[column]) for t in failed]
    said = [t.label(column) for t in failed]
    given = [(t, a, b) for t, a, b in zip(failed, true, said, strict=True) if b in CLASSES]
    out: dict[str, Any] = {
        "right": _share(sum(a == b for a, b in zip(true, said, strict=True)), len(failed)),
        "unknown": _share(sum(b == "unknown" for b in said), len(failed)),
        "macro_f1": dict(zip(("value", "low", "high"), macro_f1(true, said, CLASSES), strict=True)),
        "said": _matrix(true, said, SAID),
    }
    sure = [(max(p), a == b) for t, a, b in given if (p := t.chances(column)) is not None]
    if sure:
        stated, right = np.array([s for s, _ in sure]), np.array([r for _, r in sure])
        out["answered"] = {
            **_share(int(right.sum()), len(right)),
            "stated": float(stated.mean()),
            "calibration_error": calibration_error(stated, right),
            "calibration_error_of_a_perfect_verdict": _perfect(stated),
        }
    chances = [(p, a) for t, a in zip(failed, true, strict=True) if (p := t.chances(column))]
    if chances:
        out["brier"] = float(np.mean([_brier(p, a) for p, a in chances]))
    return out


def _brier(p: tuple[float, ...], true: str) -> float:
    """Squared error over the three classes and what is left for `unknown`; 0 to 2."""
    off = np.array(p) - np.array([c == true for c in CLASSES])
    return float(off @ off + (1.0 - sum(p)) ** 2)


def _perfect(p: Array) -> float:
    """The mean calibration error of a verdict that is right as often as it says, at as many
    answers: what chance alone gives.
    """
    rng = generator(0, "perfectly calibrated", len(p))
    return float(np.mean([calibration_error(p, rng.random(len(p)) < p) for _ in range(PERFECT)]))


def _closes(trials: Sequence[Judged]) -> dict[str, Any] | None:
    """How far the closes that were found are from the true ones, s; those not found, or found where
    there was none, by number.
    """
    known = [t for t in trials if "t_close_ns" in t.true and t.said is not None]
    if not known:
        return None
    pairs = [(t.true["t_close_ns"], t.said["t_close_ns"]) for t in known if t.said is not None]
    off = np.array([(b - a) * 1e-9 for a, b in pairs if a is not None and b is not None])
    return {
        "near": _share(int((np.abs(off) <= CLOSE_S).sum()), sum(a is not None for a, _ in pairs)),
        "median_s": float(np.median(np.abs(off))) if len(off) else None,
        "not_found": sum(a is not None and b is None for a, b in pairs),
        "invented": sum(a is None and b is not None for a, b in pairs),
    }


def markdown_of(title: str, trials: Sequence[Judged], figures: dict[str, Any]) -> str:
    """The figures that `document_of` gives of the trials as tables, and each trial whose verdict is
    wrong or missing.
    """
    parts = [f"## {title}", f"{figures['trials']} trials, {figures['failures']} failures."]
    if "outcome" in figures:
        parts += [
            f"Outcome right: {_text(figures['outcome']['right'])}",
            _grid("what is so \\ said", figures["outcome"]["said"]),
        ]
    for column, label in figures["labels"].items():
        parts += _label_parts(column, label)
    if (sub := figures.get("sub_cause")) is not None:
        parts.append(f"Sub-cause, where the class is right: {_text(sub)}")
    if (close := figures["closes"]) is not None:
        median = "–" if close["median_s"] is None else f"{close['median_s'] * 1000:.0f} ms"
        parts.append(
            f"Closes within {CLOSE_S * 1000:.0f} ms of the true one: {_text(close['near'])}; "
            f"median off {median}; not found {close['not_found']}; found where none was "
            f"{close['invented']}"
        )
    codes = ", ".join(f"{code}: {n}" for code, n in figures["exit_codes"].items())
    parts.append(f"Exit codes: {codes}")
    return "\n\n".join([*parts, *_disputes(trials)])


def _label_parts(column: str, label: dict[str, Any]) -> list[str]:
    f1 = label["macro_f1"]
    parts = [
        f"**{LABELLED[column].capitalize()}** (`{column}`): right {_text(label['right'])}, unknown "
        f"{_text(label['unknown'])}; macro-F1 {f1['value']:.2f} "
        f"[{f1['low']:.2f}, {f1['high']:.2f}]",
        _grid("what is so \\ said", label["said"]),
    ]
    if "answered" in label:
        a = label["answered"]
        parts.append(
            f"Where a class is given: right {_text(a)}, stated {a['stated']:.0%}; calibration "
            f"error {a['calibration_error']:.2f}, of a verdict that is right as often as it says "
            f"{a['calibration_error_of_a_perfect_verdict']:.2f}; Brier score {label['brier']:.2f}"
        )
    return parts


def _text(share: Mapping[str, Any]) -> str:
    low, high = share["interval"]
    if not share["n"]:
        return "–"
    part = share["k"] / share["n"]
    return f"{share['k']}/{share['n']} = {part:.0%} [{low:.0%}, {high:.0%}]"


def _grid(corner: str, rows: dict[str, dict[str, int]]) -> str:
    columns = list(next(iter(rows.values()), {}))
    names = [LABELS.get(c, c.replace("_", " ")) for c in columns]
    lines = [f"| {corner} | " + " | ".join(names) + " |", "|---" * (len(columns) + 1) + "|"]
    for name, counts in rows.items():
        cells = [LABELS.get(name, name.replace("_", " ")), *(str(counts[c]) for c in columns)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def sentence_of(figures: dict[str, Any]) -> str:
    """The figures of `document_of` that count, in one line."""
    parts = [f"{figures['failures']} failures of {figures['trials']} trials"]
    if "outcome" in figures:
        right = figures["outcome"]["right"]
        parts.append(f"outcome right in {right['k']} of {right['n']}")
    for column, name in (("failure_class", "cause"), ("observed_class", "as a person would write")):
        if (label := figures["labels"].get(column)) is not None:
            parts.append(
                f"{name} right in {label['right']['k']} of {label['right']['n']} "
                f"({label['unknown']['k']} unknown, macro-F1 {label['macro_f1']['value']:.2f})"
            )
    return ", ".join(parts)


def in_dispute(trial: Judged) -> bool:
    """Whether the verdict is wrong, or says less than is so."""
    outcome = trial.true.get("outcome")
    if outcome is not None and trial.outcome != outcome:
        return True
    true = trial.true.get("failure_class")
    return outcome == "failure" and true is not None and trial.label("failure_class") != true


def _disputes(trials: Sequence[Judged]) -> list[str]:
    """A table of the trials to look at, those that are surest of what is not so first."""
    rows = sorted((t for t in trials if in_dispute(t)), key=lambda t: (-_sure(t), t.arm, t.trial))
    several = len({t.arm for t in trials}) > 1
    if not rows:
        return ["No verdict is wrong or missing."]
    lines = ["| trial | what is so | said | why |", "|---|---|---|---|"]
    for t in rows:
        parts = [t.true.get("failure_class") or t.true.get("outcome"), t.true.get("sub_cause")]
        so = ", ".join([*(str(p).replace("_", " ") for p in parts if p), *t.marks])
        said = t.label("failure_class") if t.outcome == "failure" else t.outcome
        sure = f" {_sure(t):.0%}" if _sure(t) else ""
        why = "; ".join(t.messages) if t.said is None else str(t.said["evidence"] or "")
        if t.exit_code == EXIT_DATA_LOST and t.said is not None:
            why += f" ({'; '.join(t.messages)})"
        name = f"{t.arm}/{t.trial}" if several else t.trial
        cells = [name, so, f"{said.replace('_', ' ')}{sure}", why.replace("|", "/")]
        lines.append("| " + " | ".join(" ".join(c.split()) for c in cells) + " |")
    return ["Wrong or missing, the surest first:", "\n".join(lines)]


def _sure(trial: Judged) -> float:
    """The stated probability of the class that is given; 0 without one."""
    p = trial.chances("failure_class")
    return max(p) if p is not None and trial.label("failure_class") in CLASSES else 0.0
