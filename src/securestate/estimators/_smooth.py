"""What follows from the labels of a window: its states, its injections, and whom to trust.

Stage 3 of the cold start. The states of all samples are predicted from the honest readings in one go:

    x[k] = Phi[k] x0 + X[k] Sigma_hh^-1 (y_h - O_h x0),    X[k] = Cov(x[k], y_h)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate.estimators._anneal import Groups
from securestate.estimators._identify import Evidence
from securestate.estimators._relabel import Fit, Labels, Rows, deviation, least_squares
from securestate.estimators._window import Window

Float = NDArray[np.float64]

#: Where nothing is known of a state, the deviation at which sensors would be off by so many of theirs.
WIDE = 1e6


def smooth(model: Window, seen: Evidence, fit: Fit) -> tuple[Float, Float]:
    """Mean (tau, n) and covariance (tau, n, n) of the states, without the known response."""
    x, P = np.empty((model.tau, model.plant.n)), np.empty_like(model.V)
    beside = len(fit.rows.y) - len(seen.row)  # rows of a wide prior, which no process noise reaches
    for k, cross in enumerate(model.crosses()):
        own = np.pad(cross[:, seen.row] / seen.deviation, ((0, 0), (0, beside)))
        x[k], K, B = fit.predict(model.Phi[k], own)
        P[k] = positive(model.V[k] - K @ K.T + B @ B.T)
    return x, P


def positive(P: Float) -> Float:
    """The covariance without the asymmetry and the negative eigenvalues that rounding left."""
    P = P / 2 + P.T / 2
    try:
        linalg.cholesky(P, check_finite=False)
    except linalg.LinAlgError:
        values, vectors = linalg.eigh(P, check_finite=False)
        P = (vectors * np.maximum(values, 0.0)) @ vectors.T
        P = P / 2 + P.T / 2
    return P


def guess(model: Window, seen: Evidence, groups: Groups) -> Labels:
    """Everybody is believed, beside a prior so wide that it only counts where the readings say nothing."""
    wide = seen.rows.with_prior(model.O / np.sqrt(np.diag(model.Sigma))[:, np.newaxis], WIDE)
    rows, n = len(seen.row), model.plant.n
    h = np.append(np.flatnonzero(~seen.beyond), rows + np.arange(n))
    fit = least_squares(wide, h) or least_squares(Rows(wide.O, np.eye(rows + n), wide.y), h)
    if fit is None:  # the prior alone always determines the state
        raise AssertionError
    count = len(groups.count)
    return Labels(seen.computable(groups), fit, np.zeros(count), np.zeros(count, dtype=np.bool_))


def trusts(seen: Evidence, labels: Labels, groups: Groups) -> Float:
    """1 / (1 + d^2 / quantile) of every group, at least one half if it is believed and less if it is not."""
    trust = 1 / (1 + labels.excess)
    trust = np.where(labels.honest, np.maximum(trust, 0.5), np.minimum(trust, np.nextafter(0.5, 0.0)))
    trust = np.where(labels.honest & ~labels.tested, np.nan, trust)
    trust = np.where(seen.computable(groups), trust, 0.0)
    return np.where(groups.protected, 1.0, trust)


def injections(seen: Evidence, labels: Labels, groups: Groups) -> tuple[Float, Float]:
    """What readings are off by and its deviation, (rows,), normalised; 0 and NaN where they are believed.

    A reading beyond all sizes counts as zero here.
    """
    attack, std = np.zeros(len(seen.row)), np.full(len(seen.row), np.nan)
    out = np.flatnonzero(~(labels.honest | groups.protected)[groups.of])
    E, V = deviation(labels.fit, out)
    attack[out], std[out] = E * seen.deviation[out], np.sqrt(np.maximum(V, 0.0)) * seen.deviation[out]
    return attack, std
