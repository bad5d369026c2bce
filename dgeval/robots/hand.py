"""What dgeval asks of a hand, and which hands it knows.

A new hand is one file in this folder, or one behind the entry point group `dgeval.hands`, with a
module attribute `HAND`. Nothing outside this folder knows a finger's name or how many there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.plugins import modules_with

if TYPE_CHECKING:
    import mujoco

ENTRY_POINTS = "dgeval.hands"  # the group in which installed packages name their hands
# s, from the close command until the palm rises, of every known hand; 0.1 s of it for the grip to
# settle
LIFT_AFTER_S = 0.5
BASE = "hand_base"  # the body that a hand's solids hang on


@dataclass(frozen=True)
class Grip:
    """How a grip shows in a log, some time after the close.

    signal: which values of `joints` are read, position (rad, m) or effort (Nm, N). least: how many
    samples are needed. holds: from samples (n, len(joints)), whether the hand holds something, and
    a sentence with the figures. most: of the signal; larger values are in other units.
    """

    signal: Literal["position", "effort"]
    joints: tuple[str, ...]
    least: int
    holds: Callable[[Array], tuple[bool, str]]
    most: float = math.inf


@dataclass(frozen=True)
class Solids:
    """The hand's solids at some joint positions, for penetration with a cloud.

    axes (n, m, 2, 3) m: ends of the axes of m capsules in the frame of grasps, for n sets of joint
    positions. radius m: of all capsules. boxes: (half sizes, centre) m in the hand's base frame,
    which do not move.
    """

    axes: Array
    radius: float
    boxes: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]


@dataclass(frozen=True)
class Hand:
    """A hand as a verdict asks of it: joints, closing motion, grasp centre, solids in physics.

    name: unique, as in configurations. joints: all, in the order of joint states; drives: those
    with a drive; the k drives are in rad or m. fingers: first parts (up to "_") of the names of its
    solids.

    T_hand_palm: the frame of grasps in the base frame. centre (3,) m: where held objects are, base
    frame. approach (3,): unit vector in which the hand comes to an object, base frame. close_s: s
    from the command until the hand has closed. targets: drives at a time, s, after the close
    command, from those before it. positions: all joints from the drives. mismatch_sd, rad or m:
    standard deviation between where closing fingers come to rest in physics and in a log. add: puts
    the hand into a spec below a body; geoms have contype 2 and conaffinity 1 and are named
    "<finger>_<…>". grip: None where fingers alone don't tell. lift_after_s: s from the close
    command until the palm rises.
    """

    name: str
    joints: tuple[str, ...]
    drives: tuple[str, ...]
    fingers: tuple[str, ...]
    T_hand_palm: Array
    centre: Array
    close_s: float
    positions: Callable[[Array], Array]
    targets: Callable[[float, Array], Array]
    grip: Grip | None
    mismatch_sd: float
    add: Callable[[mujoco.MjSpec, mujoco.MjsBody], None]
    lift_after_s: float = LIFT_AFTER_S
    approach: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    @property
    def told(self) -> str:
        """What it is, for a person."""
        return self.name

    def link_of(self, solid: str) -> str:
        """The link of one of its solids, by the solid's name."""
        return solid


@dataclass(frozen=True, kw_only=True)
class SimulatedHand(Hand):
    """A hand that dgeval simulates trials with. The z axis of its base points along the fingers.

    T_hand_camera: the colour camera as calibrated. open (k,): drives before a grasp is chosen.
    drive_speed: per second. random_preshape: drives (k,) before a close, to search grasps with.
    links: the hand's links and joints below BASE as URDF text; palm_solids: the solids of BASE.
    palm_frame: of these links, the one that is the frame of grasps; None where none is, and a
    recording gets one.
    """

    T_hand_camera: Array
    open: Array
    drive_speed: float
    random_preshape: Callable[[np.random.Generator], Array]
    links: Callable[[], list[str]]
    palm_solids: str = ""
    palm_frame: str | None = None


@dataclass(frozen=True, kw_only=True)
class KnownHand(SimulatedHand):
    """A hand that dgeval also draws and plans with.

    grasp_network: the network whose weights are for this hand. opening m: between two opposite
    pads, of a hand that has them. drive_limits (2, k): lower and upper. solids: see `Solids`, from
    drives (n, k). link_points: n points (n, 3) m on the open hand's links, frame of grasps, for a
    network that takes them.
    """

    grip: Grip
    grasp_network: str
    drive_limits: Array
    solids: Callable[[Array], Solids]
    link_points: Callable[[int, np.random.Generator], Array] | None = None
    opening: float | None = None


@cache
def hands() -> tuple[KnownHand, ...]:
    """All hands, by name: the files of this folder, and those of installed packages.

    UsageError where two have the same name.
    """
    found: dict[str, tuple[KnownHand, str]] = {}
    for module in modules_with("dgeval.robots", "HAND", ENTRY_POINTS):
        hand: KnownHand = module.HAND
        if hand.name in found:
            where = f"{found[hand.name][1]} and {module.__name__}"
            raise UsageError(f"two hands are called {hand.name!r}, in {where}")
        found[hand.name] = hand, module.__name__
    return tuple(found[name][0] for name in sorted(found))


def hand_named(name: str) -> KnownHand:
    """The hand of that name. KeyError names the hands there are."""
    for hand in hands():
        if hand.name == name:
            return hand
    raise KeyError(f"no hand {name!r}; there are {', '.join(h.name for h in hands())}")


def hand_for(network: str) -> KnownHand:
    """The hand that a grasp network's weights are for: network `ffhnet` or `vfas`.

    UsageError where several say so.
    """
    named = [h for h in hands() if h.grasp_network == network]
    if len(named) != 1:
        names = ", ".join(h.name for h in named) or "none"
        raise UsageError(f"one hand must have the grasp network {network!r}; it is that of {names}")
    return named[0]


def hand_of(joints: Collection[str]) -> KnownHand | None:
    """The hand whose drives are among these joints, of several the one with most drives.

    None if no hand fits.
    """
    fitting = [h for h in hands() if set(h.drives) <= set(joints)]
    return max(fitting, key=lambda h: len(h.drives), default=None)
