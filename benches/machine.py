"""What the numbers were measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np

LIBRARIES = ("numpy", "scipy", "filterpy", "statsmodels", "cvxpy", "clarabel", "osqp")


def describe() -> list[str]:
    """Lines about processor, system and libraries."""
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return [
        f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}",
        f"Python {platform.python_version()}, securestate {version('securestate')}, {libraries}",
        f"BLAS of numpy: {blas['name']} {blas['version']}, one thread",
    ]


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown processor"
    return next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown processor"
    )
