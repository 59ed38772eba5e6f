"""States given a whole record, while channels are missing one by one: what a fit of the plant needs of
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate import _kernels

Float = NDArray[np.float64]


@final
@dataclass(frozen=True, eq=False)
class Smoothed:
    """A smoothed segment.

    Attributes:
        states: x[k|N], (N, n).
        whole: sum of P[k|N] over all samples, (n, n). first, last: P[0|N] and P[N-1|N].
        crossed: sum of cov(x[k], x[k+1] | all), (n, n).
        absent: sum of P[k|N] over the samples at which a channel is missing, (m, n, n).
        likelihood: log p(y), nats.
    """

    states: Float
    whole: Float
    first: Float
    last: Float
    crossed: Float
    absent: Float
    likelihood: float


def smooth(A: Float, C: Float, Q: Float, r: Float, start: Float, drive: Float, y: Float) -> Smoothed:
    """Smooth x[k+1] = A x[k] + g[k] + w[k], y[k] = C x[k] + v[k], x[0] ~ N(0, P0), v independent per channel.

    Args:
        A (n, n), C (m, n), Q (n, n): as in a plant. r: variances of v, (m,). start: P0, (n, n).
        drive: g, (N, n). y: (N, m), NaN where missing.
    Raises:
        InputError: a predicted covariance is not positive definite.
    References:
        Rauch, Tung, Striebel 1965.
    """
    parts = [np.ascontiguousarray(X, dtype=np.float64) for X in (A, C, Q, r, start, drive, y)]
    model = (parts[0], parts[1], parts[2], parts[3], parts[4])
    return Smoothed(**_kernels.smooth(model, parts[5], parts[6]))
