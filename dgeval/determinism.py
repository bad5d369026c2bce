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
# Packages whose versions are part of the fingerprint
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
    """Set one thread for BLAS, OpenMP and Mesa in this process and its children.

    Call it before numpy is imported.
    """
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"
    # Mesa's software renderer counts the threads besides the calling one
    os.environ["LP_NUM_THREADS"] = "0"


def limit_threads() -> None:
    """Set one thread in the libraries that are already loaded.

    BLAS by threadpoolctl, OpenCV and torch by their own functions.
    """
    import cv2
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1)
    cv2.setNumThreads(1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def generator(seed: int, stage: str, frame: int) -> np.random.Generator:
    """Random generator keyed by seed, stage and frame index in the trial, and by nothing else.

    Philox with the SHA-256 of "seed/stage" as its key and the frame as its counter. So draws don't
    depend on the order or the number of earlier draws.
    """
    import numpy as np

    key = hashlib.sha256(f"{seed}/{stage}".encode()).digest()[:16]
    return np.random.Generator(
        np.random.Philox(key=int.from_bytes(key, "little"), counter=[0, 0, 0, frame])
    )


def fingerprint() -> dict[str, str]:
    """Versions and features of the platform that may change the last bits of a result.

    Processor, system, C library, Python, and the installed packages of FINGERPRINT_PACKAGES.
    """
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

    Columns go in by sorted name. Each value starts with a byte: 0 for null, 1 for a value. Numbers
    follow little-endian in 8 bytes (one bit pattern for NaN, -0 as 0), text as UTF-8 after its
    length.
    """

    def __init__(self, columns: dict[str, str]) -> None:
        self._columns = [
            (name, kind, hashlib.sha256(f"{name}:{kind}".encode()))
            for name, kind in sorted(columns.items())
        ]
        self._rows = 0

    def add(self, row: Mapping[str, Any]) -> None:
        """Add one row; a missing key is a null. Kinds of columns: bool, int, float, str."""
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
