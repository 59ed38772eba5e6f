"""Moments of a record over lags, and a regression on the past that chooses its own length.

    z[k] = (u[k], y[k]),   M = average of [z[k], z[k-1], ..., z[k-p]] [...]'

One pass over the data whatever follows: orders, gains and noises all come from M.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate.identification.forms import Record

Array = NDArray[np.float64]

#: Ridge on the regressions, relative to every regressor's own variance.
RIDGE = 1e-6


def lag_moments(record: Record, p: int) -> tuple[Array, int]:
    """Return M, shape ((p + 1) z, (p + 1) z), and over how many samples it was averaged; exact over segments.

    Block (i + 1, j + 1) is block (i, j) moved back by one sample: the sum gains its first term and loses its
    last one. So only the first row of blocks costs a pass over the data.
    """
    width = sum(part.shape[1] for part in record[0])
    blocks = np.zeros((p + 1, p + 1, width, width))
    samples = 0
    for y, u in record:
        z, N = np.hstack([u, y]), len(y)
        if p >= N:
            continue
        samples += N - p
        for lag in range(p + 1):
            product = z[p:].T @ z[p - lag : N - lag]
            blocks[0, lag] += product
            for i in range(p - lag):
                first, last = p - i - 1, N - 1 - i
                product = product + np.outer(z[first], z[first - lag]) - np.outer(z[last], z[last - lag])
                blocks[i + 1, i + 1 + lag] += product
    for i in range(p + 1):
        for j in range(i):
            blocks[i, j] = blocks[j, i].T
    size = (p + 1) * width
    return blocks.transpose(0, 2, 1, 3).reshape(size, size) / max(samples, 1), samples


def past_length(record: Record, longest: int, feedthrough: bool) -> int:
    """How many past samples predict the next y best: corrected Akaike criterion of a vector regression
    (VARX).
    """
    m, q = record[0][0].shape[1], record[0][1].shape[1]
    width = m + q
    M, samples = lag_moments(record, longest)
    of_y = np.arange(q, width)
    regressors = np.concatenate([np.arange(q if feedthrough else 0), np.arange(width, len(M))])
    L = np.linalg.cholesky(ridged(M[np.ix_(regressors, regressors)], 1e-8))
    explained = linalg.solve_triangular(L, M[np.ix_(regressors, of_y)], lower=True)
    costs = []
    for p in range(1, longest + 1):
        k = p * width + (q if feedthrough else 0)
        left = M[np.ix_(of_y, of_y)] - explained[:k].T @ explained[:k]
        _, size = np.linalg.slogdet(left + 1e-12 * np.eye(m))
        costs.append(size + 2 * k * m / max(samples - k - m - 1, 1))
    return int(np.argmin(costs)) + 1


def ridged(M: Array, ridge: float = RIDGE) -> Array:
    """M with a ridge, so that regressors which repeat each other do no harm."""
    return np.asarray(M + ridge * np.diag(np.maximum(np.diag(M), 1e-12)))
