"""What the detectors share: thresholds from a false-alarm rate, and the kernel that leaves sensors out."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import special

from securestate import _kernels
from securestate._local_filters import LocalFilter
from securestate._steady_state import SteadyState
from securestate.errors import InputError
from securestate.estimators.kalman import prior_covariance
from securestate.plant import Plant

Float = NDArray[np.float64]

#: Prior, rule, quantiles and local filters of a detector, as kernels take them.
Arguments = tuple[Float | None, str, Float, list[Any]]

Rule = Literal["gate", "drop", "hold", "predict", "drop-worst"]


def checked_rate(value: object) -> float:
    """A false-alarm rate as a number.

    Raises:
        InputError: it is no number in (0, 1).
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < 1:
        raise InputError("false_alarm_rate", "a number in (0, 1)", repr(value))
    return float(value)


def quantiles(channels: int, false_alarm_rate: float) -> Float:
    """Chi-square quantile 1 - false_alarm_rate for 0, 1, ... channels, (channels + 1,); infinite for none."""
    bounds = special.chdtri(np.arange(1, channels + 1), false_alarm_rate)
    return np.concatenate([[np.inf], np.asarray(bounds, dtype=np.float64)])


def kernel(
    plant: Plant,
    steady: SteadyState | None,
    rule: Rule,
    false_alarm_rate: float,
    filters: Sequence[LocalFilter] = (),
) -> _kernels.Kernel:
    """The Kalman filter of `plant` with a rule; `filters` are those of the sensors, if the rule asks them."""
    prior, name, bounds, local = arguments(plant, steady, rule, false_alarm_rate, filters)
    return _kernels.detector(plant, prior, rule=name, quantiles=bounds, local=local)


def arguments(
    plant: Plant,
    steady: SteadyState | None,
    rule: Rule,
    false_alarm_rate: float,
    filters: Sequence[LocalFilter] = (),
) -> Arguments:
    """Prior, rule, quantiles and local filters of a detector, as kernels take them."""
    local = [(f.T, f.A, f.B, f.C, f.D, f.gain, f.innovation_cov) for f in filters]
    return (
        prior_covariance(steady),
        rule,
        quantiles(plant.m, false_alarm_rate),
        [tuple(map(np.ascontiguousarray, matrices)) for matrices in local],
    )
