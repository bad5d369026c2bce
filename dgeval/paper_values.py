"""What a configuration has that the papers don't, for a trial's notes: from the values alone."""

from __future__ import annotations

from typing import Any, Final

from dgeval.config import Config

# the papers' values of the parameters that they give (docs/papers.md, "Table V: parameters";
# docs/papers.md, "VFAS parameters")
GIVEN: Final[dict[str, Any]] = {
    "observation.c_z": 0.1,
    "registration.c_a_f": 0.8,
    "registration.c_a_v": 4.0,
    "registration.c_a_w": 4.0,
    "fusion.n_s": 5,
    "fusion.epsilon": 0.01,
    "selection.c_m_s": 1.0,
    "selection.c_m_t": -0.1,
    "selection.c_m_r": -0.2,
    "servo.c_p_v": 1.0,
    "servo.c_d_v": 2.0,
    "servo.c_p_w": 2.5,
    "servo.c_d_w": 5.0,
    "servo.c_O": 0.2,
    "servo.c_G": 0.05,
    "vfas.half_width": 0.02,
    "vfas.half_angle": 5.0,
    "vfas.noise_candidates": "all",
    "vfas.noise": 0.002,
    "vfas.good_score": 0.5,
    "vfas.adaptive": True,
    "vfas.factor": 1.3,
    "vfas.most_factor": 3.0,
    "vfas.motion_field": True,
    "vfas.low_pass": True,
    "vfas.period_s": 0.05,
    "vfas.hold_iterations": 5,
    "vfas.search_ahead": 0.15,
    "vfas.refine": True,
}
# parameters of rules that are ours, and the values with which they do nothing
OURS: Final[dict[str, Any]] = {
    "registration.colour": False,
    "registration.accept": "gate",
    "grasps.max_overlap": 1.0,
    "grasps.support_z": None,
    "grasps.way_m": 0.0,
    "selection.keep_margin": 0.0,
    "selection.literal_eq5": False,
    "selection.rotation_vector_difference": False,
    "servo.beyond_m": 0.0,
    "execution.arrived_m": None,
    "vfas.keep_seed": False,
    "vfas.hold_needs_score": False,
}
PERCEPTION: Final = ("observation", "registration", "fusion")
CHOICE: Final = ("grasps", "selection")
CONTROL: Final = ("servo", "execution")


def departures(config: Config, sections: tuple[str, ...]) -> list[str]:
    """Each parameter of some sections that is not as in the paper, with its value.

    A rule of ours is named where it is on, a parameter that the papers give where it is another.
    """
    out = []
    for name, paper in (*GIVEN.items(), *OURS.items()):
        section, key = name.split(".")
        if section not in sections:
            continue
        value = getattr(getattr(config, section), key)
        if value != paper and name in GIVEN:
            out.append(f"{name} = {value} (paper: {paper})")
        elif value != paper:
            out.append(f"{name} = {value} (ours)")
    return out


def departure_note(config: Config, sections: tuple[str, ...]) -> list[str]:
    """One note that lists them; none where there are none."""
    listed = ", ".join(departures(config, sections))
    return [f"not as in the paper: {listed}"] if listed else []
