"""From the innovations form to independent noises: S and K of the one explained by Q and r of the other.

The outputs' law fixes A P C' = K S and the off-diagonal of C P C' = that of S, where P = cov(x) -
cov(x[k|k-1]) is unknown. P is fitted by least squares and projected to be a covariance; then

    r = diag(S - C P C'),   Q = P - A P A' + K S K'

Not every innovations form has independent noises. What is lost is measured afterwards (`order`), and maximum
likelihood starts from here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from securestate.identification.forms import Independent, Innovations, symmetric

Array = NDArray[np.float64]

#: Weight of the ridge that decides where the data leave P open.
RIDGE = 1e-4

#: A sensor's noise as a share of its innovation's variance, at least and at most.
LEAST, MOST = 0.05, 0.98


def independent_of(model: Innovations) -> Independent:
    """The nearest model with independent noises, as a start for maximum likelihood.

    Raises:
        LinAlgError: a channel has no noise at all.
    """
    A, C, K, S, n = model.A, model.C, model.K, model.S, model.n
    if not np.all(np.diag(S) > 0):
        raise np.linalg.LinAlgError("a channel is predicted without error")
    weight = 1 / np.sqrt(np.diag(S))
    i, j = np.tril_indices(n)
    upper = np.triu_indices(len(S), 1)
    units = np.zeros((len(i), n, n))
    units[np.arange(len(i)), i, j] = units[np.arange(len(i)), j, i] = 1.0
    seen = units @ C.T
    moved = (A @ seen) * weight
    crossed = (C @ seen * np.outer(weight, weight))[:, *upper]
    design = np.hstack([moved.reshape(len(i), -1), crossed]).T
    target = np.concatenate([(K @ S * weight).ravel(), (S * np.outer(weight, weight))[upper]])
    normal = design.T @ design
    ridge = RIDGE * np.trace(normal) / len(normal)
    entries = np.linalg.solve(normal + ridge * np.eye(len(normal)), design.T @ target)
    P = _floored(np.einsum("k,kij->ij", entries, units), 1e-6)
    r = np.clip(np.diag(S - C @ P @ C.T), LEAST * np.diag(S), MOST * np.diag(S))
    Q = P - A @ P @ A.T + K @ S @ K.T
    largest = float(np.linalg.eigvalsh(symmetric(Q))[-1])
    return Independent(A, model.B, C, model.D, _floored(Q, 1e-3 * max(largest, 1e-6)), r)


def _floored(X: Array, least: float) -> Array:
    """X with every eigenvalue at least this."""
    values, V = np.linalg.eigh(symmetric(X))
    return symmetric((V * np.maximum(values, least)) @ V.T)
