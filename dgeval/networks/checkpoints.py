"""Reading of weights from safetensors files and from the authors' PyTorch files.

A PyTorch file is a pickle, which can run code when it is loaded. Here only tensors and plain
containers are rebuilt. Objects of known libraries beside the weights become empty placeholders. A
pickle that names anything else is refused.
"""

from __future__ import annotations

import hashlib
import pickle
import types
import zipfile
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor, nn

from dgeval.errors import Place, UsageError

# SHA-256 of the published files, from their Git LFS pointers (docs/papers.md, "Checkpoints")
PUBLISHED = {
    "eb572b6047f93c979c44d657ef55df275646c42a73cba8e43c01302ac06e41ff": (
        "FFHNet generator, published (10_gen_net.pt)"
    ),
    "5397584b96806c311170b84ce52d6a526e8577f5db84036c4917be8758e44d8c": (
        "FFHNet evaluator, published (30_eva_net.pt)"
    ),
}
# first digits of the SHA-256 of GMFlow's published files, which their names end with
# (docs/papers.md, "Checkpoints")
PUBLISHED_GMFLOW = {
    "e9887eda": "GMFlow, published (gmflow_things)",
    "0c07dcb3": "GMFlow, published (gmflow_sintel)",
    "285701a8": "GMFlow, published (gmflow_kitti)",
    "36579974": "GMFlow with refinement, published (gmflow_with_refine_things)",
    "3ed1cf48": "GMFlow with refinement, published (gmflow_with_refine_sintel)",
    "8d3b9786": "GMFlow with refinement, published (gmflow_with_refine_kitti)",
}
# of TransT's published files the names are known and the content isn't
NAMES_OF_TRANST = ("transt.pth", "transtm.pth", "transtm_vot.pth")
# (module, name) of the functions and types that PyTorch rebuilds a tensor with
_REBUILD = {
    ("torch._utils", "_rebuild_tensor"),
    ("torch._utils", "_rebuild_tensor_v2"),
    ("torch._utils", "_rebuild_parameter"),
    ("torch", "Size"),
    ("torch", "device"),
    ("collections", "OrderedDict"),
    ("torch.serialization", "_get_layout"),
}
# modules whose objects are stored beside the weights (optimisers, schedulers, settings); they are
# read as empty placeholders
_INERT = ("ltr", "pytracking", "torch.optim", "functools", "numpy", "easydict", "argparse")

LEVELS = 47  # quantisation steps on each side of zero, in a matrix stored as int8
STEP_SUFFIX = "/step"  # a matrix `name` stores the step sizes of its rows under `name/step`


class _Placeholder:
    """Stands in for an object that is not needed; accepts any arguments and any state."""

    def __init__(self, *args: object, **kwargs: object) -> None: ...

    def __setstate__(self, state: object) -> None: ...

    def __setitem__(self, key: object, value: object) -> None: ...

    def append(self, value: object) -> None: ...

    def extend(self, values: object) -> None: ...


class _Unpickler(pickle.Unpickler):
    """Rebuilds tensors, gives placeholders for known companions, and refuses everything else."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _REBUILD or (
            module == "torch" and (name.endswith("Storage") or name in _DTYPES)
        ):
            return super().find_class(module, name)
        if module.split(".")[0] in _INERT or module.startswith("torch.optim"):
            return type(name, (_Placeholder,), {})
        raise pickle.UnpicklingError(
            f"{module}.{name} is refused: a checkpoint holds tensors and settings"
        )


_DTYPES = {
    str(d).removeprefix("torch.") for d in vars(torch).values() if isinstance(d, torch.dtype)
}
# torch.load accepts a module to use in place of `pickle`
_restricted = types.ModuleType("restricted_pickle")
_restricted.__dict__.update(
    Unpickler=_Unpickler,
    load=lambda f, **k: _Unpickler(f, **k).load(),
    UnpicklingError=pickle.UnpicklingError,
)


def read_weights(path: Path, key: str | None = None) -> dict[str, Tensor]:
    """State dict of a weights file: .safetensors, or PyTorch's zip or legacy container.

    key: the entry of a PyTorch container that holds the state dict; a container without that entry
    must be a state dict itself. The prefix `module.` is removed from names. Raises UsageError if
    the file is missing, truncated or refused, or if there is no state dict.
    """
    place = Place(str(path))
    if not path.is_file():
        raise UsageError("no such file of weights", place)
    try:
        if path.suffix == ".safetensors":
            return dequantised(load_file(path))
        with path.open("rb") as file:
            content: Any = torch.load(
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
    state = content.get(key, content) if key is not None and isinstance(content, dict) else content
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        names = (
            ", ".join(map(str, list(content)[:6]))
            if isinstance(content, dict)
            else type(content).__name__
        )
        raise UsageError(f"no state dict {key or ''} in it; there is: {names}", place)
    return {name.removeprefix("module."): tensor for name, tensor in state.items()}


def metadata_of(path: Path) -> dict[str, str]:
    """The metadata of a .safetensors file; an empty dict for other containers."""
    if path.suffix != ".safetensors":
        return {}
    with safe_open(path, "pt") as file:
        return file.metadata() or {}


def quantised(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Quantise the matrices of a state dict to int8, from -LEVELS to LEVELS steps.

    Each row of a matrix has its own step size, stored beside the matrix under `name + STEP_SUFFIX`.
    Tensors that are not matrices stay as they are.
    """
    out = {}
    for name, tensor in state.items():
        if tensor.ndim != 2:
            out[name] = tensor.contiguous()
            continue
        step = tensor.abs().amax(1, keepdim=True).clamp(min=1e-12) / LEVELS
        out[name], out[name + STEP_SUFFIX] = torch.round(tensor / step).to(torch.int8), step
    return out


def dequantised(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Undo `quantised`: step counts times step size. Tensors without a step stay as they are."""
    return {
        k: v * state[k + STEP_SUFFIX] if k + STEP_SUFFIX in state else v
        for k, v in state.items()
        if not k.endswith(STEP_SUFFIX)
    }


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


def load_strictly(network: nn.Module, weights: dict[str, Tensor], source: str) -> None:
    """Load weights into a network, cast to its dtypes, and put the network into eval mode.

    source: the file's path, for the message. Raises UsageError that names the first key that is
    missing, has another shape or values that are not finite, or is unknown to the network.
    """
    expected = network.state_dict()
    for name, tensor in expected.items():
        if name not in weights:
            raise UsageError(
                f"weights of {type(network).__name__}: {name} is missing", Place(source)
            )
        if weights[name].shape != tensor.shape:
            shapes = f"{tuple(weights[name].shape)}, not {tuple(tensor.shape)}"
            raise UsageError(
                f"weights of {type(network).__name__}: {name} has shape {shapes}", Place(source)
            )
    if unknown := [name for name in weights if name not in expected]:
        raise UsageError(
            f"weights of {type(network).__name__}: {unknown[0]} is not a part of it", Place(source)
        )
    cast = {name: tensor.to(expected[name].dtype) for name, tensor in weights.items()}
    for name, tensor in cast.items():
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise UsageError(
                f"weights of {type(network).__name__}: {name} has values that are not finite",
                Place(source),
            )
    network.load_state_dict(cast)
    network.eval()


def shipped(name: str) -> Path:
    """A file of the weights that come with dgeval."""
    return Path(str(resources.files("dgeval.networks") / "weights" / name))


def version_of(path: Path) -> tuple[int, int]:
    """Time of its last change, ns, and size of a file, for caches: other content is read again.

    Zeros of a file that isn't there.
    """
    if not path.is_file():
        return 0, 0
    found = path.stat()
    return found.st_mtime_ns, found.st_size


@cache
def published(path: Path) -> str | None:
    """Description of a published weights file, recognised by its SHA-256; None for any other."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return PUBLISHED.get(digest) or PUBLISHED_GMFLOW.get(digest[:8])


def name_of_weights(path: Path) -> str:
    """How a note calls a file of weights: as its authors do where it is known to be theirs."""
    known = published(path)
    if known is not None:
        return known
    if path.name in NAMES_OF_TRANST:
        return f"weights {path.name} (named as the authors' file; whether it is theirs isn't known)"
    if any(path.stem.endswith(f"-{prefix}") for prefix in PUBLISHED_GMFLOW):
        return f"weights {path.name} (named as a published file, whose content is another)"
    return f"weights {path.name}"
