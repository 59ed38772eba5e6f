"""Means over independent runs, with the standard errors that independence gives."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from papers._report import Value

Float = NDArray[np.float64]


def mean(samples: Float) -> Value:
    """Mean of (runs, T) samples, with the standard error of independent runs."""
    per_run = samples.mean(axis=1)
    return Value(float(per_run.mean()), float(per_run.std(ddof=1) / np.sqrt(len(per_run))))


def ratio(above: Float, below: Float) -> Value:
    """Ratio of two means over the same runs, with its standard error."""
    a, b = above.mean(axis=1), below.mean(axis=1)
    value = a.mean() / b.mean()
    return Value(float(value), float((a - value * b).std(ddof=1) / np.sqrt(len(a)) / b.mean()))


def prefixed(name: str, values: Mapping[str, Value]) -> dict[str, Value]:
    """The same numbers under longer keys."""
    return {f"{name}.{key}": value for key, value in values.items()}
