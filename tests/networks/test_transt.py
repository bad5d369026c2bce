"""Catches networks and tracking loops that differ from TransT's and TransT-M's.

`reference/transt.npz` is what the authors' layers and trackers (chenxin-dlut/TransT and TransT-M on
GitHub) make of `filled` weights, and of `picture` and `video` images.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from dgeval.errors import UsageError
from dgeval.networks.checkpoints import name_of_weights
from dgeval.networks.images import normalised
from dgeval.networks.transt import TransT, TransTM, load_transt
from dgeval.networks.transt_loop import Sighting, TransTLoop
from filled import PATCH, filled, picture, video

REFERENCE = np.load(Path(__file__).parent / "reference" / "transt.npz")
SEARCH, FIRST, SECOND = (picture(1, 256, 256), picture(2, 128, 128), picture(3, 128, 128))


@pytest.fixture(scope="module")
def transt() -> TransT:
    return filled(TransT())


@pytest.fixture(scope="module")
def transtm() -> TransTM:
    return filled(TransTM())


def test_transt_is_the_originals(transt: TransT) -> None:
    """Catches another dilation, number of heads, order of attention or code of positions."""
    found = transt(normalised(SEARCH), (transt.template(normalised(FIRST)),))
    assert np.abs(found.logits.numpy() - REFERENCE["t_logits"]).max() < 1e-4
    assert np.abs(found.boxes.numpy() - REFERENCE["t_boxes"]).max() < 1e-5
    assert (found.iou, found.mask) == (None, None)


def test_transtm_is_the_originals(transtm: TransTM) -> None:
    """Catches another order of templates, another token that asks for the mask, other fusions."""
    templates = tuple(transtm.template(normalised(crop)) for crop in (FIRST, SECOND))
    found = transtm(normalised(SEARCH), templates)
    assert found.iou is not None
    assert found.mask is not None
    assert np.abs(found.logits.numpy() - REFERENCE["m_logits"]).max() < 1e-4
    assert np.abs(found.boxes.numpy() - REFERENCE["m_boxes"]).max() < 1e-5
    assert np.abs(found.iou.numpy() - REFERENCE["m_iou"]).max() < 1e-5
    assert np.abs(found.mask.numpy()[::4, ::4] - REFERENCE["m_mask"]).max() < 1e-5


def tracked(loop: TransTLoop) -> list[Sighting]:
    first, *rest = video(3)
    loop.start(first, tuple(float(v) for v in PATCH))
    return [loop.step(frame) for frame in rest]


def corner_and_size(sightings: list[Sighting]) -> np.ndarray:
    boxes = np.array([s.box for s in sightings])
    return np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)


def test_transt_tracks_as_the_original(transt: TransT) -> None:
    """Catches a crop shifted by half a pixel, another filling, another weight of the window."""
    found = tracked(TransTLoop(transt))
    assert np.abs(corner_and_size(found) - REFERENCE["t_track"]).max() < 0.02
    assert all(s.probability is None and s.iou is None for s in found)


@pytest.mark.parametrize(("name", "update_iou"), [("kept", 0.869), ("new", 0.4)])
def test_transtm_tracks_as_the_original(transtm: TransTM, name: str, update_iou: float) -> None:
    """Catches a template that isn't made anew, or is at the old box, and a mask put elsewhere."""
    found = tracked(TransTLoop(transtm, update_iou=update_iou))
    assert np.abs(corner_and_size(found) - REFERENCE[f"{name}_track"]).max() < 0.02
    masks = np.array([s.probability > 0.6 for s in found if s.probability is not None])
    wanted = np.unpackbits(REFERENCE[f"{name}_masks"]).reshape(2, 240, 320) > 0
    assert (masks & wanted).sum() > 0.999 * (masks | wanted).sum() > 1000


def test_a_doubted_place_makes_no_new_template(transtm: TransTM) -> None:
    """Catches a template of the background, once the target is lost."""
    sure = tracked(TransTLoop(transtm, update_iou=0.4))
    doubting = tracked(TransTLoop(transtm, update_iou=0.4, lost_below=0.99))
    kept = tracked(TransTLoop(transtm))
    assert corner_and_size(doubting) == pytest.approx(corner_and_size(kept))
    assert np.abs(corner_and_size(doubting) - corner_and_size(sure)).max() > 0.2


def test_the_reference_tells_a_new_template_from_an_old_one() -> None:
    assert np.abs(REFERENCE["kept_track"] - REFERENCE["new_track"]).max() > 0.2


@pytest.fixture
def authors_package() -> ModuleType:
    """The package `ltr`, whose objects the authors' checkpoints hold beside the weights."""
    module = ModuleType("ltr.admin.settings")
    made = type("Settings", (), {"__module__": "ltr.admin.settings"})
    module.Settings = made  # type: ignore[attr-defined]
    return module


@pytest.mark.parametrize("zipped", [True, False])
@pytest.mark.parametrize(
    ("network", "keys"),
    [(TransT(), 430), (TransT(2), None), (TransTM(has_mask=False), 436), (TransTM(), 478)],
    ids=["transt", "transt-n2", "box and iou", "transt-m"],
)
def test_a_file_of_the_authors_says_which_network_it_is_of(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    authors_package: ModuleType,
    network: TransT,
    keys: int | None,
    zipped: bool,
) -> None:
    """Catches a loader that needs the authors' package, or takes the parts from the file's name."""
    for name in ("ltr", "ltr.admin", "ltr.admin.settings"):
        monkeypatch.setitem(sys.modules, name, authors_package)
    path = tmp_path / "transt.pth"
    content = {"net": network.state_dict(), "settings": authors_package.Settings(), "epoch": 500}
    torch.save(content, path, _use_new_zipfile_serialization=zipped)
    for name in ("ltr", "ltr.admin", "ltr.admin.settings"):
        monkeypatch.delitem(sys.modules, name)
    loaded = load_transt(path)
    assert type(loaded) is type(network)
    state = loaded.state_dict()
    assert keys is None or len(state) == keys
    assert all(torch.equal(state[name], value) for name, value in network.state_dict().items())


def test_other_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "transt.pth"
    torch.save({"net": {"backbone.weight": torch.zeros(3)}}, path)
    with pytest.raises(UsageError, match="no layer of a fusion is in them"):
        load_transt(path)
    state = TransT().state_dict()
    del state["bbox_embed.layers.1.bias"]
    torch.save({"net": state}, path)
    with pytest.raises(UsageError, match=r"bbox_embed\.layers\.1\.bias is missing"):
        load_transt(path)
    assert "whether it is theirs isn't known" in name_of_weights(path)
    state = TransT().state_dict()
    state["class_embed.layers.0.bias"][3] = float("nan")
    torch.save({"net": state}, path)
    with pytest.raises(UsageError, match=r"class_embed\.layers\.0\.bias has values that are not"):
        load_transt(path)
