"""The training loop of all networks: AdamW, a cosine schedule, and checkpoints to resume from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

SAVE_EVERY = 500  # steps between two checkpoints


def optimise(
    network: nn.Module,
    loss_of: Callable[[int], tuple[Tensor, dict[str, float]]],
    steps: int,
    rates: tuple[float, float],
    about: dict[str, Any],
    checkpoint: Path,
    progress: Callable[[int, dict[str, float]], None],
) -> None:
    """Train `network` in place for `steps` steps, and leave it in eval mode.

    - loss_of(step): the loss and its terms. It must draw from the step alone, so that a resumed run
      ends like an uninterrupted one.
    - rates: learning rate and weight decay.
    - about: all settings of the run. A checkpoint file with the same ones is resumed; otherwise
      training starts anew.
    - progress(step, terms): called after each step; steps count from 1.
    """
    optimiser = torch.optim.AdamW(network.parameters(), rates[0], weight_decay=rates[1])
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    parts: dict[str, Any] = {"network": network, "optimiser": optimiser, "schedule": schedule}
    start = 0
    if (
        checkpoint.is_file()
        and (saved := torch.load(checkpoint, weights_only=True))["about"] == about
    ):
        for name, part in parts.items():
            part.load_state_dict(saved[name])
        start = saved["step"]
    network.train()
    for step in range(start, steps):
        loss, terms = loss_of(step)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        progress(step + 1, terms)
        if (step + 1) % SAVE_EVERY == 0 or step + 1 == steps:
            part_file = checkpoint.with_suffix(".part")
            torch.save(
                {
                    **{name: part.state_dict() for name, part in parts.items()},
                    "about": about,
                    "step": step + 1,
                },
                part_file,
            )
            part_file.rename(checkpoint)
    network.eval()
