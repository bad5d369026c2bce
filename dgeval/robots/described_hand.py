"""A hand from its description alone, as a verdict asks of it.

Of a description geometry, kinds of joints, axes, limits and coupling are facts. Its masses,
inertias, damping and friction are not: they were set for other programs, and dgeval's own are used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np

from dgeval.geometry import Array, transform
from dgeval.robots.description import Description, Joint
from dgeval.robots.hand import LIFT_AFTER_S, Hand
from dgeval.robots.hand_geometry import HandGeometry
from dgeval.robots.hand_links import HandLinks
from dgeval.robots.hand_solids import add_solids
from dgeval.robots.link_shapes import capsules_of

if TYPE_CHECKING:
    import mujoco

FORCE_N = 15.0  # N of a fingertip, as the physics is made; each draw has its own; ours
ANY_FORCE_N = LEAST_FORCE_N, MOST_FORCE_N = 3.0, 60.0  # N; grippers on the market; ours
# of a finger joint: position error, rad and m, at which its drive gives all its force; ours
ALL_FORCE_RAD, ALL_FORCE_M = 0.3, 0.010
KV = 0.05  # s, of a drive's velocity gain against its position gain; as the known hands' drives
DAMPING = 0.025, 20.0  # of a joint that turns, Nm s/rad, and slides, N s/m; as the known hands'
MISMATCH_RAD, MISMATCH_M = 0.03, 0.002  # as of the known hands
CLOSE_S = 0.5  # s, in which a hand closes whose own time is not known; ours
LINK_KG, LINK_KGM2 = 0.03, 2e-5  # of a finger's link: small, so that its drive moves it; ours


@dataclass(frozen=True)
class DescribedHand(Hand):
    """A hand that is known from its description.

    without_solids: its solids are capsules, as the description has none. closing_source: where its
    closing motion is from: the trial itself, another trial of the hand, the configuration, or the
    joints' limits. force_n: least and most force of a fingertip, N.
    """

    geometry: HandGeometry = field(kw_only=True)
    without_solids: bool = field(kw_only=True)
    closing_source: Literal["recorded", "estimates", "set", "limits"] = field(
        default="limits", kw_only=True
    )
    force_n: tuple[float, float] = field(default=ANY_FORCE_N, kw_only=True)

    @property
    def told(self) -> str:
        """What it is, for a person."""
        count = len(self.geometry.tips)
        fingers = "one finger" if count == 1 else f"{count} fingers"
        solids = ", as capsules" if self.without_solids else ""
        return f"{fingers} on {self.geometry.links.base!r}{solids}, by the description alone"

    def force_factors(self, factor: float) -> Array:
        """(k,) on what each drive gives as the physics is made, of a factor on the force of the
        fingertips: none gives more than its description says.
        """
        usual = FORCE_N * self.geometry.levers
        efforts = [joint.effort for joint in self.geometry.joints]
        return np.asarray(np.minimum(factor * usual, efforts) / np.minimum(usual, efforts))

    @property
    def lags_s(self) -> Array:
        """(k,) s, by which a joint that nothing meets follows the target of its drive too late."""
        joints = self.geometry.joints
        forces = np.minimum(FORCE_N * self.geometry.levers, [joint.effort for joint in joints])
        lost = [DAMPING[joint.kind == "prismatic"] for joint in joints]
        reach = [ALL_FORCE_M if joint.kind == "prismatic" else ALL_FORCE_RAD for joint in joints]
        return np.asarray(KV + np.array(lost) * np.array(reach) / forces)

    def link_of(self, solid: str) -> str:
        """The link of one of its solids, by the solid's name, as `add_hand` gives it."""
        return solid.split("_", 1)[1].rsplit("_", 1)[0]


def described_hand(
    description: Description,
    links: HandLinks,
    T_base_palm: Array,
    open_positions: Array,
    closed: Mapping[str, float] = MappingProxyType({}),
    close_s: float = CLOSE_S,
    centre: Array | None = None,
    approach: Array | None = None,
) -> DescribedHand:
    """The hand of some links of a description; without solids it gets capsules.

    T_base_palm (4, 4): the frame of grasps. open_positions (k,): of the joints, rad or m, before
    the close, in the order of `HandLinks.joints`. closed: positions of the closed hand that a user
    names, by joint. close_s: s, in which it closes. centre (3,) m, approach (3,): as in `Hand`, in
    the frame of grasps, where a user names them.
    """
    members = [link for finger in links.fingers for link in finger]
    without_solids = not any(description.shapes.get(link) for link in members)
    if without_solids:
        joints, centres = description.joints, description.mass_centres
        capsules = {
            link: capsules_of(link, joints, centres.get(link), description.radius)
            for link in (links.base, *members)
        }
        description = replace(description, shapes={**description.shapes, **capsules})
    opened = np.asarray(open_positions, dtype=np.float64)
    geometry = HandGeometry(description, links, opened, tuple(closed.items()))
    meets = geometry.meeting(geometry.closed)
    at = meets if centre is None else transform(T_base_palm, centre[None])[0]
    along = geometry.ahead(at) if approach is None else T_base_palm[:3, :3] @ approach
    slides = sum(joint.kind == "prismatic" for joint in geometry.joints)

    def add(spec: mujoco.MjSpec, base: mujoco.MjsBody) -> None:
        add_hand(spec, base, geometry)

    return DescribedHand(
        name=f"described:{links.base}",
        joints=geometry.names,
        drives=geometry.names,
        fingers=tuple(_finger_name(finger) for finger in links.fingers),
        T_hand_palm=T_base_palm,
        centre=at,
        approach=along / np.linalg.norm(along),
        close_s=close_s,
        lift_after_s=max(LIFT_AFTER_S, close_s),
        positions=np.copy,
        targets=partial(_straight, geometry.closed, close_s),
        grip=None,
        mismatch_sd=MISMATCH_M if 2 * slides > len(geometry.joints) else MISMATCH_RAD,
        add=add,
        geometry=geometry,
        without_solids=without_solids,
        closing_source="set" if closed else "limits",
    )


def _straight(closed: Array, close_s: float, since_close: float, preshape: Array) -> Array:
    """Targets of the drives that lead from where they were to the closed hand (k,) in close_s."""
    share = float(np.clip(since_close / close_s, 0.0, 1.0))
    return np.asarray(preshape + share * (closed - preshape))


def _finger_name(finger: tuple[str, ...]) -> str:
    """The first part of its solids' names, which ends at the first underscore."""
    return finger[0].replace("_", "-")


def add_hand(spec: mujoco.MjSpec, base: mujoco.MjsBody, geometry: HandGeometry) -> None:
    """Put palm, fingers, drives and couplings below a body; solids don't meet each other."""
    from dgeval.robots.mjcf import place

    description, links = geometry.description, geometry.links
    base.gravcomp = 1
    T = geometry.poses(np.zeros(len(geometry.names)))
    for link in links.palm:
        add_solids(spec, base, description.shapes.get(link, []), T[link], f"palm_{link}")
    for finger in links.fingers:
        bodies: dict[str, mujoco.MjsBody] = {}
        label = _finger_name(finger)
        for link in finger:
            joint = description.joints[link]
            above = bodies.get(joint.parent)
            body = (base if above is None else above).add_body(name=f"{label}_{link}", gravcomp=1)
            place(body, joint.origin if above is not None else T[joint.parent] @ joint.origin)
            bodies[link] = body
            add_solids(spec, body, description.shapes.get(link, []), np.eye(4), f"{label}_{link}")
            body.mass, body.inertia, body.explicitinertial = LINK_KG, [LINK_KGM2] * 3, True
            if joint.kind != "fixed":
                _add_joint(spec, body, joint, FORCE_N * geometry.lever(joint))
                if joint.follows != joint.name and joint.follows in geometry.names:
                    _couple(spec, joint)


def _add_joint(spec: mujoco.MjSpec, body: mujoco.MjsBody, joint: Joint, force: float) -> None:
    """The joint of a body with its drive. force: at most, Nm or N."""
    import mujoco

    slides = joint.kind == "prismatic"
    limited = bool(np.isfinite([joint.lower, joint.upper]).all())
    body.add_joint(
        name=joint.name,
        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
        axis=joint.axis,
        range=[joint.lower, joint.upper] if limited else [0, 0],
        limited=limited,
        damping=DAMPING[slides],
        armature=0.1 if slides else 1.5e-4,  # kg, kg m^2; as the known hands'
    )
    force = min(force, joint.effort)
    stiffness = force / (ALL_FORCE_M if slides else ALL_FORCE_RAD)
    drive = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    drive.set_to_position(kp=stiffness, kv=KV * stiffness)
    drive.forcelimited, drive.forcerange = True, [-force, force]


def _couple(spec: mujoco.MjSpec, joint: Joint) -> None:
    """Couple a joint to the one that it follows."""
    import mujoco

    couple = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_JOINT,
        name1=joint.name,
        name2=joint.follows,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        solref=[0.004, 1],  # s, damping ratio; as the known hands'
    )
    couple.data = [joint.offset, joint.multiplier, *[0] * (len(couple.data) - 2)]
