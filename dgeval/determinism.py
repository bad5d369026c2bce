"""One thread per process, counter-based draws, digests, and the fingerprint of the platform."""

from __future__ import annotations

import hashlib
import math
import os
import platform
import struct
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)
FINGERPRINT_PACKAGES = (
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "small_gicp",
    "open3d-cpu",
    "open3d",
    "kiss-icp",
    "filterpy",
    "mcap",
    "rosbags",
    "pyarrow",
    "torch",
)


def set_thread_variables() -> None:
    """Ask every BLAS, OpenMP and Mesa of this process and its children for one thread. Before numpy is imported."""
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"
    # Mesa's software renderer counts the threads beside the one that calls it
    os.environ["LP_NUM_THREADS"] = "0"


def limit_threads() -> None:
    """One thread in the libraries that are already loaded (BLAS by threadpoolctl, OpenCV and torch by their own switch)."""
    import cv2
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1)
    cv2.setNumThreads(1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def generator(seed: int, stage: str, frame: int) -> np.random.Generator:
    """Random draws keyed by (seed, stage, frame index in the trial) alone: Philox with that key."""
    import numpy as np

    key = hashlib.sha256(f"{seed}/{stage}".encode()).digest()[:16]
    return np.random.Generator(
        np.random.Philox(key=int.from_bytes(key, "little"), counter=[0, 0, 0, frame])
    )


def fingerprint() -> dict[str, str]:
    """What may change the last bits of a result: processor, C library, Python and library versions."""
    from importlib import metadata

    out = {
        "machine": platform.machine(),
        "system": platform.system(),
        "libc": "-".join(platform.libc_ver()),
        "python": platform.python_version(),
        "cpu_features": _cpu_features(),
    }
    for name in FINGERPRINT_PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return out


def _cpu_features() -> str:
    import numpy as np

    core: Any = np._core if hasattr(np, "_core") else np.core
    features: dict[str, bool] = core._multiarray_umath.__cpu_features__
    return " ".join(sorted(name for name, present in features.items() if present))


_NAN = struct.pack("<d", math.nan)


class ColumnDigest:
    """SHA-256 over typed columns with nulls, fed row by row; equal for any chunking.

    Names sorted, numbers little-endian in 8 bytes, one NaN pattern, -0 as 0, text UTF-8 with its length before it, each
    value preceded by a byte that says whether it is null.
    """

    def __init__(self, columns: dict[str, str]) -> None:
        self._columns = [
            (name, kind, hashlib.sha256(f"{name}:{kind}".encode()))
            for name, kind in sorted(columns.items())
        ]
        self._rows = 0

    def add(self, row: Mapping[str, Any]) -> None:
        """Take one row in; a missing key is a null. Kinds: bool, int, float, str."""
        self._rows += 1
        for name, kind, digest in self._columns:
            value = row.get(name)
            if value is None:
                digest.update(b"\0")
            elif kind == "float":
                # adding 0.0 turns -0.0 into 0.0
                digest.update(b"\1" + (_NAN if value != value else struct.pack("<d", value + 0.0)))
            elif kind == "str":
                raw = value.encode()
                digest.update(b"\1" + len(raw).to_bytes(8, "little") + raw)
            else:
                digest.update(b"\1" + int(value).to_bytes(8, "little", signed=True))

    def hexdigest(self) -> str:
        total = hashlib.sha256(self._rows.to_bytes(8, "little"))
        for _, _, digest in self._columns:
            total.update(digest.digest())
        return total.hexdigest()
