"""Catches a network that differs from GMFlow, and a pair of frames that is matched with others.

`reference/gmflow.npz` is what the original's layers (of ptlflow 0.4.2, images normalised as the
authors do it) make of `filled` weights and `picture` images.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from dgeval.config import load_config
from dgeval.errors import UsageError
from dgeval.networks.checkpoints import name_of_weights
from dgeval.networks.gmflow import GMFlow, load_gmflow
from dgeval.networks.images import normalised
from dgeval.planning.vfas.motion_field import gmflow
from filled import filled, picture

REFERENCE = np.load(Path(__file__).parent / "reference" / "gmflow.npz")


def checkpoint(folder: Path, refine: bool) -> Path:
    """A file of weights in the authors' container."""
    path = folder / "gmflow_things-e9887eda.pth"
    state = filled(GMFlow(refine)).state_dict()
    torch.save({"model": state, "optimizer": {"state": {}}, "step": 7}, path)
    return path


@pytest.fixture
def in_double_precision(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What single precision makes of these weights differs by 0.01 px from CPU to CPU."""
    monkeypatch.setattr("dgeval.networks.gmflow.normalised", lambda i: normalised(i).double())
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.usefixtures("in_double_precision")
@pytest.mark.parametrize("name", ["basic", "refine"])
def test_flow_is_the_originals(name: str) -> None:
    """Catches keys projected from the features, unshifted windows, a border on one side only."""
    network = filled(GMFlow(refine=name == "refine")).double()
    flow = network(picture(1, 50, 70), picture(2, 50, 70))
    assert np.abs(REFERENCE[name]).max() > 30
    assert np.abs(flow - REFERENCE[name]).max() < 1e-2


@pytest.mark.parametrize("refine", [False, True])
def test_a_file_says_which_network_it_is_of(tmp_path: Path, refine: bool) -> None:
    network = load_gmflow(checkpoint(tmp_path, refine))
    assert len(network.levels) == 1 + refine
    assert len(network.state_dict()) == 123 + refine


def test_a_file_that_lacks_a_part_is_refused_by_its_name(tmp_path: Path) -> None:
    path = checkpoint(tmp_path, False)
    content = torch.load(path, weights_only=True)
    del content["model"]["upsampler.2.bias"]
    torch.save(content, path)
    with pytest.raises(UsageError, match=r"upsampler\.2\.bias is missing"):
        load_gmflow(path)


def test_each_frames_features_are_made_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a flow that takes the features of another frame, and one that makes them twice."""
    made: list[int] = []
    features = GMFlow.features
    monkeypatch.setattr(
        GMFlow, "features", lambda self, image: made.append(1) or features(self, image)
    )
    flow = gmflow(checkpoint(tmp_path, False))
    frames = [picture(seed, 50, 70) for seed in (1, 2, 3)]
    flow(frames[0], frames[1])
    assert len(made) == 2
    second = flow(frames[1], frames[2])
    assert len(made) == 3
    fresh = gmflow(checkpoint(tmp_path, False))(frames[1].copy(), frames[2].copy())
    assert np.array_equal(second, fresh)
    after_a_gap = flow(frames[0], frames[2])  # not the pair that was expected
    assert len(made) == 7
    assert not np.array_equal(after_a_gap, second)


def test_weights_and_method_go_together() -> None:
    load_config("vfas", ("vfas.flow=gmflow", "vfas.flow_weights=x.pth"))
    with pytest.raises(UsageError, match="flow_weights, a file of the authors"):
        load_config("vfas", ("vfas.flow=gmflow",))
    with pytest.raises(UsageError, match=r'with vfas\.flow = "gmflow" only'):
        load_config("vfas", ("vfas.flow_weights=x.pth",))


def test_a_name_alone_makes_no_published_file(tmp_path: Path) -> None:
    said = name_of_weights(checkpoint(tmp_path, False))
    assert "named as a published file, whose content is another" in said
