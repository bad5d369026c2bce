"""What the trials of a run show of their hands together: `estimates.json`, written and read.

No trial of the run uses it. Given to another run (`dgeval replay --estimates`) it is an input like
a configuration, and its digest stands in each row.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError, model_validator

from dgeval.errors import Place, UsageError
from dgeval.geometry import Array
from dgeval.verdict.described_grip import AT_LIMIT
from dgeval.verdict.estimates import Estimates, HandShown
from dgeval.verdict.log import HandEstimate
from dgeval.verdict.recorded_closing import Closing
from dgeval.worlds.closing import CONTROL_S

FILE = "estimates.json"
DIGITS = 6  # behind the point, of rad and m
LEAST_ALIKE = 2  # trials that must come to rest alike, to be said to have closed on nothing; ours
Floats = list[FiniteFloat]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Closing(_Strict):
    """before, speeds, until (k,), way (m, k) as `Closing`. trial: whose it is. close_s_sd: over all
    trials that show one, s; null for one alone."""

    trial: str
    trials: list[str]
    before: Floats
    way: list[Floats]
    speeds: Floats
    until: Floats | None = None
    close_s: FiniteFloat
    close_s_sd: FiniteFloat | None


class _Empty(_Strict):
    """rest (k,): where the joints rest, sd (k,): of each over the trials."""

    trials: list[str]
    rest: Floats
    sd: Floats


class _Hand(_Strict):
    key: str
    told: str
    joints: list[str]
    closing: _Closing | None
    empty: _Empty | None

    @model_validator(mode="after")
    def _one_number_a_joint(self) -> _Hand:
        rows: list[Floats] = []
        if self.closing is not None:
            if not self.closing.way:
                raise ValueError("the way has no moment")
            rows += [self.closing.before, self.closing.speeds, *self.closing.way]
            rows += [self.closing.until or self.closing.before]
        if self.empty is not None:
            rows += [self.empty.rest, self.empty.sd]
        if any(len(row) != len(self.joints) for row in rows):
            raise ValueError(f"a posture has not one number for each of {len(self.joints)} joints")
        return self


class _File(_Strict):
    version: Literal[1]
    period_s: FiniteFloat
    hands: list[_Hand]

    @model_validator(mode="after")
    def _our_period(self) -> _File:
        if self.period_s != CONTROL_S:
            raise ValueError(f"period_s is not {CONTROL_S:g}")
        return self


def shown_as_json(shown: HandShown) -> dict[str, Any]:
    """What a trial shows of its hand, as its commit mark keeps it."""
    closing = shown.closing
    return {
        "key": shown.key,
        "told": shown.told,
        "joints": list(shown.joints),
        "spans": _rounded(shown.spans),
        "closing": closing
        and {
            "before": _rounded(closing.before),
            "way": _rounded(closing.way),
            "speeds": _rounded(closing.speeds),
            "until": None if closing.until is None else _rounded(closing.until),
        },
        "empty": None if shown.empty is None else _rounded(shown.empty),
    }


def _rounded(values: Array) -> Any:
    return (np.round(values, DIGITS) + 0.0).tolist()


def estimates_of(shown: Iterable[tuple[str, dict[str, Any]]]) -> str | None:
    """The text of `estimates.json` from what each trial, by its id, shows; None where none does.

    The same for any order of the trials.
    """
    by_hand: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for trial, one in sorted(shown, key=lambda pair: pair[0]):
        by_hand.setdefault(one["key"], []).append((trial, one))
    hands = []
    for key, listed in sorted(by_hand.items()):
        closing, empty = _closing(listed), _empty(listed)
        first = listed[0][1]
        if closing is not None or empty is not None:
            hands.append(
                _Hand(
                    key=key,
                    told=first["told"],
                    joints=first["joints"],
                    closing=closing,
                    empty=empty,
                )
            )
    if not hands:
        return None
    return _File(version=1, period_s=CONTROL_S, hands=hands).model_dump_json(indent=1) + "\n"


def _closing(listed: Sequence[tuple[str, dict[str, Any]]]) -> _Closing | None:
    """Of the trials with a close the one in which the object stopped the fewest joints, of these
    the one that took the middle time.
    """
    found = [(trial, one["closing"]) for trial, one in listed if one["closing"]]
    if not found:
        return None
    lasts = {trial: len(closing["way"]) * CONTROL_S for trial, closing in found}
    usual = float(np.median(list(lasts.values())))
    trial, best = min(
        found,
        key=lambda f: (int(np.count_nonzero(f[1]["speeds"])), abs(lasts[f[0]] - usual), f[0]),
    )
    sd = float(np.std(list(lasts.values()), ddof=1)) if len(found) > 1 else None
    return _Closing(
        trial=trial,
        trials=[t for t, _ in found],
        close_s=round(lasts[trial], DIGITS),
        close_s_sd=None if sd is None else round(sd, DIGITS),
        **best,
    )


def _empty(listed: Sequence[tuple[str, dict[str, Any]]]) -> _Empty | None:
    """Where the fingers rest in the most trials alike that had nothing between them."""
    found = [(trial, np.array(one["empty"])) for trial, one in listed if one["empty"]]
    if not found:
        return None
    near = AT_LIMIT * np.array(listed[0][1]["spans"])
    alike = [
        [k for k, (_, other) in enumerate(found) if (np.abs(other - rest) < near).all()]
        for _, rest in found
    ]
    most = max(alike, key=len)
    if len(most) < LEAST_ALIKE:
        return None
    rests = np.array([found[k][1] for k in most])
    return _Empty(
        trials=[found[k][0] for k in most],
        rest=_rounded(np.median(rests, axis=0)),
        sd=_rounded(rests.std(axis=0, ddof=1)),
    )


def read_estimates(path: Path) -> Estimates:
    """The estimates of a file that a run has written; UsageError where it is none."""
    place = Place(str(path))
    hint = f"give the {FILE} of a finished run"
    try:
        data = (path / FILE if path.is_dir() else path).read_bytes()
        listed = _File.model_validate_json(data)
    except OSError as error:
        raise UsageError(
            f"the estimates can't be read ({type(error).__name__})", place, hint
        ) from error
    except ValidationError as error:
        first = error.errors()[0]
        what = f"{'.'.join(str(k) for k in first['loc'])}: {first['msg']}"
        raise UsageError(f"these are no estimates ({what})", place, hint) from error
    hands = {hand.key: _estimate(hand) for hand in listed.hands}
    return Estimates(hands, hashlib.sha256(data).hexdigest())


def _estimate(hand: _Hand) -> HandEstimate:
    c, e = hand.closing, hand.empty
    closing = None
    if c is not None:
        until = None if c.until is None else np.array(c.until)
        closing = Closing(np.array(c.before), np.array(c.way), np.array(c.speeds), until)
    return HandEstimate(closing, None if e is None else np.array(e.rest))
