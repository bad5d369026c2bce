"""The one sequence that closes, lifts, holds and decides, on a scripted world without physics.

Catches: a hold that is asked only at its end or is too short, a condition of success left out, a
lost touch that counts before the lift is over, a presenter who lets go at once or never, a rise
counted from the wrong height, a shake that goes on, and a second sequence elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.geometry import Array
from dgeval.worlds.closing import Finish
from dgeval.worlds.hand_and_object import CloseAndLift, Touch

CLOSED, LIFTED, HELD = 0.5, 1.2, 2.2  # s after the close command: lift begins, ends; hold is over
REST = 0.04
NOT_GIVEN_UP = 0.0101  # m, a rise of just more than is given up
CENTRE = np.array([0.05, 0.01, 0.16])


@dataclass
class Script:
    """What a world does by time since the close, s: the object's rise m, and so on."""

    rise: Callable[[float], float] = lambda t: 0.2 * float(np.clip((t - CLOSED) / 0.7, 0, 1))
    touches: Callable[[float], bool] = lambda _: True
    off: Callable[[float], float] = lambda _: 0.0
    forces: Callable[[float], tuple[float, ...]] = lambda _: (1.0, 1.0, 0.0, 0.0, 0.0)
    presented_at: float | None = None
    periods: int = 0
    twists: list[Array] = field(default_factory=list)


class World:
    """A hand and an object that follow a script."""

    rest = REST
    object = 0

    def __init__(self, script: Script) -> None:
        self.script = script
        self.held_by_presenter = script.presented_at is not None
        self.let_go_s: float | None = None
        self.gripper = SimpleNamespace(
            centre=CENTRE, targets=lambda t, drives: drives + t, lift_after_s=CLOSED
        )
        self.data = SimpleNamespace(qpos=np.zeros(3))
        self._place()

    @property
    def t(self) -> float:
        return self.script.periods * 0.01

    def _place(self) -> None:
        at = REST if self.script.presented_at is None else self.script.presented_at
        self.data.qpos = np.array([self.script.off(self.t), 0.0, at + self.script.rise(self.t)])

    def move_hand(self, twist: Array, fingers: Array) -> None:
        self.script.twists.append(twist)
        self.fingers = fingers
        self.script.periods += 1
        self._place()

    def touch(self) -> Touch:
        return Touch(self.script.touches(self.t), False, 0.0, None)

    def finger_forces(self) -> Array:
        return np.array(self.script.forces(self.t))

    def hand_over(self) -> None:
        self.held_by_presenter, self.let_go_s = False, self.t

    def T_base_hand(self) -> Array:
        """The grasp centre is where the object is, but for `off` along x."""
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[:3, 3] = [0.0, 0.0, self.data.qpos[2]] - T[:3, :3] @ CENTRE
        return T


def run(script: Script, **options: Any) -> tuple[bool, float, World]:
    """Success, when it was certain, s after the close, and the world then."""
    world = World(script)
    closing = CloseAndLift(world, np.zeros(5), np.array([0.1, 0.0, 0.0]), **options)  # type: ignore[arg-type]
    held = closing.finish()
    return held, closing.since_s, world


def test_what_is_held_for_a_second_after_the_lift_is_a_success() -> None:
    """Catches a hold of another length."""
    held, at, _ = run(Script())
    assert held
    assert at == pytest.approx(HELD)


@pytest.mark.parametrize("lost", [LIFTED, 1.7, HELD])
@pytest.mark.parametrize(
    "what",
    [
        lambda t0: {"touches": lambda t: abs(t - t0) > 0.004},
        lambda t0: {"off": lambda t: 0.151 if abs(t - t0) < 0.004 else 0.149},
        lambda t0: {"rise": lambda t: 0.099 if abs(t - t0) < 0.004 else 0.101 * float(t > CLOSED)},
    ],
    ids=["touch", "distance", "height"],
)
def test_one_period_without_any_of_the_conditions_is_a_failure(
    what: Callable[[float], dict[str, Any]], lost: float
) -> None:
    """Catches a condition asked at the end only, at the start only, or not at all."""
    held, at, _ = run(Script(**what(lost)))
    assert not held
    assert at == pytest.approx(lost)
    assert run(Script(**what(LIFTED - 0.02)))[0], "before the lift is over it may be lost"
    assert run(Script(**what(HELD + 0.02)))[0], "after the hold too"


def test_what_is_left_behind_is_given_up_early() -> None:
    """Catches a failure that takes as long as a success, and one given up before the lift."""
    held, at, _ = run(Script(rise=lambda _: 0.0099))
    assert (held, at) == (False, pytest.approx(CLOSED + 0.45 * 0.7 + 0.005, abs=0.006))
    late = Script(rise=lambda t: NOT_GIVEN_UP if t < LIFTED else 0.2)
    assert run(late)[0], "just above that it is not certain yet"


def test_the_greatest_rise_counts_from_where_it_stood() -> None:
    """Catches the last height taken for the greatest, and the height over the base."""
    world = World(Script(rise=lambda t: 0.06 if abs(t - 0.8) < 0.004 else 0.0))
    closing = CloseAndLift(world, np.zeros(5), np.zeros(3))  # type: ignore[arg-type]
    assert not closing.finish()
    assert closing.height == pytest.approx(0.06)


def test_a_person_lets_go_of_what_two_fingers_have_pressed_for_a_moment() -> None:
    """Catches one finger for two, a moment that is added up over breaks, and a hold in the air."""
    pressing = lambda t: (0.31, 0.31) if t > 0.4 else (0.31, 0.29)  # noqa: E731
    held, _, world = run(Script(presented_at=0.3, forces=pressing))
    assert held
    assert world.let_go_s == pytest.approx(0.5, abs=0.011)
    broken = lambda t: (1.0, 1.0) if int(t * 100) % 8 else (0.0, 1.0)  # noqa: E731
    held, at, world = run(Script(presented_at=0.3, forces=broken))
    assert world.let_go_s is None
    assert (held, at) == (False, pytest.approx(LIFTED)), "the person holds it still"


def test_what_was_presented_must_rise_above_where_it_was_at_the_close() -> None:
    """Catches a rise over the support for something that was held in the air."""
    assert not run(Script(presented_at=0.3, rise=lambda t: 0.09 * float(t > CLOSED)))[0]


def test_the_hand_follows_closes_lifts_and_waits() -> None:
    """Catches fingers that lag a period, and a hand that stops before its way up is made."""
    script = Script()
    _, _, world = run(script)
    twists = np.array(script.twists)
    np.testing.assert_array_equal(twists[:50], np.tile([0.1, 0, 0, 0, 0, 0], (50, 1)))
    assert twists[:, 2].sum() * 0.01 == pytest.approx(0.2, abs=2e-4)
    assert not twists[round(LIFTED * 100) :].any()
    np.testing.assert_allclose(world.fingers, (len(twists) - 1) * 0.01)


def test_a_shake_lasts_for_one_and_a_half_periods_of_the_hold() -> None:
    """Catches a shake during the lift, and one that never ends or starts with a jump."""
    script = Script()
    world = World(script)
    closing = CloseAndLift(world, np.zeros(5), np.zeros(3), shake_m=0.02)  # type: ignore[arg-type]
    closing.finish()
    along = np.array(script.twists)[:, :2] @ [0.8, 0.6]
    first = round(LIFTED * 100)
    assert not along[:first].any()
    assert not along[first + 30 :].any()
    places = np.cumsum(along[first : first + 30]) * 0.01
    assert places[9] == pytest.approx(0.02)
    assert places[19] == pytest.approx(0.0, abs=1e-12)
    assert places[29] == pytest.approx(0.02)
    assert np.abs(places).max() == pytest.approx(0.02)


def test_a_lift_as_recorded_is_followed_and_sets_the_height() -> None:
    """Catches our own lift in its place, 0.10 m asked of a lift of 0.08 m, and a hand that goes on
    after it.
    """
    twists = np.zeros((100, 6))
    twists[20:, 2] = 0.1
    finish = Finish(twists)
    assert finish.needed_m == pytest.approx(0.04)
    assert Finish(3 * twists).needed_m == pytest.approx(0.10)
    for rise, held in ((0.039, False), (0.041, True)):
        script = Script(rise=lambda t, rise=rise: rise * float(t > 0.3))
        said, at, _ = run(script, finish=finish)
        assert (said, at) == (held, pytest.approx(2.0 if held else 1.0))
        np.testing.assert_array_equal(script.twists[:100], twists)
        assert not np.any(script.twists[100:])
    # left behind: the hand has risen by 0.032 m, 0.32 s after it began
    said, at, _ = run(Script(rise=lambda _: 0.0), finish=finish)
    assert (said, at) == (False, pytest.approx(0.53, abs=0.011))


def test_nothing_else_in_the_package_closes_and_lifts() -> None:
    """Catches a second sequence, with constants of its own."""
    root = Path(__file__).parents[2] / "dgeval"
    words = re.compile(r"\b(finishing_twist|LIFT_HEIGHT|MIN_LIFT|MAX_FROM_HAND|HOLD_S|swing)\b")
    using = {f.name for f in root.rglob("*.py") if words.search(f.read_text(encoding="utf-8"))}
    assert using == {"closing.py", "hand_and_object.py"}
