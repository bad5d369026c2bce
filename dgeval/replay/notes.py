"""What a trial's row says of the replay: stand-ins, and what ran in place of the papers' parts."""

from __future__ import annotations

from pathlib import Path

from dgeval.config import Config


def vfas_notes(config: Config, seeded: bool) -> list[str]:
    """What ran in place of VFAS-Grasp's own parts."""
    weights = config.vfas.evaluator
    quality = "dgeval's own weights" if weights is None else f"weights {Path(weights).name}"
    notes = [
        f"VFAS-Grasp's evaluator with {quality}; sliding fingers stand for its gripper's links"
    ]
    if config.vfas.motion_field:
        notes.append("stand-in: DIS in place of GMFlow")
    if config.vfas.noise_candidates == "top8":
        notes.append("noisy copies of the eight leading candidates, in place of all")
    if not seeded and not config.vfas.search:
        seeds = config.vfas.contact_graspnet
        notes.append(
            "stand-in: a sampler scored by the evaluator in place of Contact-GraspNet's seed" if seeds is None
            else f"seed by Contact-GraspNet, weights {Path(seeds).name}"
        )  # fmt: skip
    return notes
