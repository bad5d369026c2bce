"""Weights from files: safetensors, and the authors' PyTorch containers without running what is pickled in them."""

from __future__ import annotations

import hashlib
import pickle
import types
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor, nn

from dgeval.errors import Place, UsageError

# of the published files, by their Git LFS pointers (PAPERS section 1.2)
PUBLISHED = {
    "eb572b6047f93c979c44d657ef55df275646c42a73cba8e43c01302ac06e41ff": "FFHNet generator, published (10_gen_net.pt)",
    "5397584b96806c311170b84ce52d6a526e8577f5db84036c4917be8758e44d8c": "FFHNet evaluator, published (30_eva_net.pt)",
}
# what tensors are rebuilt by
_REBUILD = {
    ("torch._utils", "_rebuild_tensor"), ("torch._utils", "_rebuild_tensor_v2"), ("torch._utils", "_rebuild_parameter"),
    ("torch", "Size"), ("torch", "device"), ("collections", "OrderedDict"), ("torch.serialization", "_get_layout"),
}  # fmt: skip
# modules whose objects lie beside the weights (optimisers, schedulers, settings): read as empty shells
_INERT = ("ltr", "pytracking", "torch.optim", "functools", "numpy", "easydict", "argparse")


LEVELS, STEP = (
    47,
    "/step",
)  # of quantised matrices: steps to each side, and the name of a row's step behind the matrix's


class _Shell:
    """Stands for an object that is of no interest; takes any arguments and any state."""

    def __init__(self, *args: object, **kwargs: object) -> None: ...

    def __setstate__(self, state: object) -> None: ...

    def __setitem__(self, key: object, value: object) -> None: ...

    def append(self, value: object) -> None: ...

    def extend(self, values: object) -> None: ...


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _REBUILD or (
            module == "torch" and (name.endswith("Storage") or name in _DTYPES)
        ):
            return super().find_class(module, name)
        if module.split(".")[0] in _INERT or module.startswith("torch.optim"):
            return type(name, (_Shell,), {})
        raise pickle.UnpicklingError(
            f"{module}.{name} is refused: a checkpoint holds tensors and settings"
        )


_DTYPES = {
    str(d).removeprefix("torch.") for d in vars(torch).values() if isinstance(d, torch.dtype)
}
# torch.load takes the place of the pickle module from its caller
_restricted = types.ModuleType("restricted_pickle")
_restricted.__dict__.update(
    Unpickler=_Unpickler,
    load=lambda f, **k: _Unpickler(f, **k).load(),
    UnpicklingError=pickle.UnpicklingError,
)


def read_weights(path: Path, key: str | None = None) -> dict[str, Tensor]:
    """State dict of a file: .safetensors, or PyTorch's zip or legacy container, `key` naming the entry that holds it.

    UsageError where the file is missing, cut off, refused, or without that entry.
    """
    place = Place(str(path))
    if not path.is_file():
        raise UsageError("no such file of weights", place)
    try:
        if path.suffix == ".safetensors":
            return dequantised(load_file(path))
        with path.open("rb") as file:
            whole: Any = torch.load(
                file, map_location="cpu", pickle_module=_restricted, weights_only=False
            )
    except pickle.UnpicklingError as error:
        raise UsageError(f"not a file of weights that is safe to read: {error}", place) from error
    except (
        RuntimeError,
        EOFError,
        OSError,
        ValueError,
        KeyError,
        zipfile.BadZipFile,
        SafetensorError,
    ) as error:
        raise UsageError(
            f"weights can't be read, cut off or no checkpoint ({_first_line(error)})", place
        ) from error
    found = whole.get(key, whole) if key is not None and isinstance(whole, dict) else whole
    if not isinstance(found, dict) or not all(isinstance(v, Tensor) for v in found.values()):
        names = (
            ", ".join(map(str, list(whole)[:6]))
            if isinstance(whole, dict)
            else type(whole).__name__
        )
        raise UsageError(f"no state dict {key or ''} in it; there is: {names}", place)
    return {name.removeprefix("module."): tensor for name, tensor in found.items()}


def metadata_of(path: Path) -> dict[str, str]:
    """What a .safetensors file says beside its weights; nothing for other containers."""
    if path.suffix != ".safetensors":
        return {}
    with safe_open(path, "pt") as file:
        return file.metadata() or {}


def quantised(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Matrices in LEVELS whole steps to each side, of a step per row beside them."""
    out = {}
    for name, tensor in state.items():
        if tensor.ndim != 2:
            out[name] = tensor.contiguous()
            continue
        step = tensor.abs().amax(1, keepdim=True).clamp(min=1e-12) / LEVELS
        out[name], out[name + STEP] = torch.round(tensor / step).to(torch.int8), step
    return out


def dequantised(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The inverse of `quantised`; other tensors as they are."""
    return {
        k: v * state[k + STEP] if k + STEP in state else v
        for k, v in state.items()
        if not k.endswith(STEP)
    }


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


def load_strictly(network: nn.Module, weights: dict[str, Tensor], source: str) -> None:
    """Put weights into a network. UsageError names the first key that is missing, of another shape, or unknown."""
    wanted = network.state_dict()
    for name, tensor in wanted.items():
        if name not in weights:
            raise UsageError(
                f"weights of {type(network).__name__}: {name} is missing", Place(source)
            )
        if weights[name].shape != tensor.shape:
            shapes = f"{tuple(weights[name].shape)}, not {tuple(tensor.shape)}"
            raise UsageError(
                f"weights of {type(network).__name__}: {name} has shape {shapes}", Place(source)
            )
    if unknown := [name for name in weights if name not in wanted]:
        raise UsageError(
            f"weights of {type(network).__name__}: {unknown[0]} is not a part of it", Place(source)
        )
    network.load_state_dict(
        {name: tensor.to(wanted[name].dtype) for name, tensor in weights.items()}
    )
    network.eval()


@cache
def published(path: Path) -> str | None:
    """What a file is, where its SHA-256 is that of a published one."""
    with path.open("rb") as file:
        return PUBLISHED.get(hashlib.file_digest(file, "sha256").hexdigest())
