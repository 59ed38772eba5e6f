"""What the states of an independent model were, given the whole record: the E-step, and the M-step that uses
it.

With z = (x, u), the complete data's log-likelihood depends on the record through moments only,

    sum z z', sum z x[k+1]', sum x[k+1] x[k+1]'  over transitions;   sum z z', sum z y', sum y^2  over
    samples,

whose expectations `Moments` holds. Its gradient there is the gradient of the likelihood of y (Fisher's
identity).

References:
    shumway1982: EM for state-space models; smoothing after Rauch, Tung and Striebel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate.identification._scan import scan
from securestate.identification.forms import (
    Independent,
    Predictor,
    Record,
    innovations_of,
    log_density,
    spread,
    stationary,
    symmetric,
)

Array = NDArray[np.float64]


@final
@dataclass(eq=False)
class Moments:
    """Expected sums; z = (x, u).

    Attributes:
        zz, zx, xx: over transitions k -> k+1: z z' (n + q, n + q), z x[k+1]' (n + q, n), x[k+1] x[k+1]' (n,
            n).
        gg, gy, yy: over samples: z z' (n + q, n + q), z y' (n + q, m), y^2 (m,).
        transitions, samples: how many.
        likelihood: log-likelihood of the record, nats.
    """

    zz: Array
    zx: Array
    xx: Array
    gg: Array
    gy: Array
    yy: Array
    transitions: int = 0
    samples: int = 0
    likelihood: float = 0.0

    @classmethod
    def none(cls, model: Independent) -> Moments:
        """Of an empty record."""
        n, (m, q) = model.n, model.D.shape
        z, zeros = n + q, np.zeros
        return cls(zeros((z, z)), zeros((z, n)), zeros((n, n)), zeros((z, z)), zeros((z, m)), zeros(m))

    def process_noise(self, AB: Array) -> Array:
        """Expected sum of w w', w = x[k+1] - [A B] z, (n, n)."""
        crossed = AB @ self.zx
        return symmetric(self.xx - crossed - crossed.T + AB @ self.zz @ AB.T)

    def sensor_noise(self, CD: Array) -> Array:
        """Expected sum of v^2, v = y - [C D] z, (m,)."""
        crossed = np.einsum("ij,ji->i", CD, self.gy)
        return np.asarray(self.yy - 2 * crossed + np.einsum("ij,jk,ik->i", CD, self.gg, CD))


def expect(model: Independent, record: Record) -> Moments:
    """E-step on segments without missing samples, each long enough for the filter to be stationary.

    Raises:
        LinAlgError: the model has no stationary filter.
    """
    steady = stationary(model)
    predict = Predictor(innovations_of(model, steady))
    P, L, A = steady.P, steady.L, model.A
    filtered = symmetric(P - L @ model.C @ P)
    J = np.asarray(np.linalg.solve(P, A @ filtered).T, dtype=np.float64)
    smoothed = symmetric(np.asarray(linalg.solve_discrete_lyapunov(J, filtered - J @ P @ J.T)))
    sums, n = Moments.none(model), model.n
    for y, u in record:
        e, x = predict(y, u)
        # x[k|N] = x[k|k] + J (x[k+1|N] - x[k+1|k]), from the end backwards
        backwards = x[:-1] + e @ L.T
        backwards[:-1] -= x[1:-1] @ J.T
        states = scan(J, backwards[::-1])[:0:-1]
        sums.likelihood += float(np.sum(log_density(e, steady.S)))
        _add(sums, states, y, u)
    sums.zz[:n, :n] += sums.transitions * smoothed
    sums.zx[:n] += sums.transitions * (smoothed @ J.T).T
    sums.xx += sums.transitions * smoothed
    sums.gg[:n, :n] += sums.samples * smoothed
    return sums


def _add(sums: Moments, states: Array, y: Array, u: Array) -> None:
    """Add the products of the smoothed means of one segment."""
    z = np.hstack([states, u])
    sums.zz += z[:-1].T @ z[:-1]
    sums.zx += z[:-1].T @ states[1:]
    sums.xx += states[1:].T @ states[1:]
    sums.gg += z.T @ z
    sums.gy += z.T @ y
    sums.yy += np.sum(y**2, axis=0)
    sums.transitions += len(y) - 1
    sums.samples += len(y)


def expect_with_gaps(model: Independent, record: Record) -> Moments:
    """E-step with missing channels (NaN): the exact filter and smoother, whose covariances vary in time."""
    sums = Moments.none(model)
    # The start is not known: its covariance is that of the state in the long run, as `Predictor` assumes.
    start = spread(model.A, model.Q + model.B @ model.B.T)
    for y, u in record:
        _smooth(model, start, y, u, sums)
    return sums


def _smooth(model: Independent, start: Array, y: Array, u: Array, sums: Moments) -> None:
    """One segment of `expect_with_gaps`."""
    N, n, A = len(y), model.n, model.A
    present = np.isfinite(y)
    moved, through = u @ model.B.T, u @ model.D.T
    x, P = np.zeros(n), start
    predicted, predicted_cov = np.empty((N, n)), np.empty((N, n, n))
    states, covs = np.empty((N, n)), np.empty((N, n, n))
    for k in range(N):
        predicted[k], predicted_cov[k] = x, P
        seen = present[k]
        if seen.any():
            C = model.C[seen]
            e = y[k, seen] - C @ x - through[k, seen]
            S = C @ P @ C.T
            S[np.diag_indices_from(S)] += model.r[seen]
            factor = linalg.cho_factor(S, lower=True, check_finite=False)
            L = linalg.cho_solve(factor, C @ P, check_finite=False).T
            whitened = linalg.cho_solve(factor, e, check_finite=False)
            size = 2 * np.sum(np.log(np.diag(factor[0]))) + len(e) * np.log(2 * np.pi)
            sums.likelihood -= 0.5 * float(e @ whitened + size)
            x, P = x + L @ e, symmetric(P - L @ C @ P)
        states[k], covs[k] = x, P
        x, P = A @ x + moved[k], symmetric(A @ P @ A.T + model.Q)
    for k in range(N - 2, -1, -1):
        J = np.linalg.solve(predicted_cov[k + 1], A @ covs[k]).T
        states[k] += J @ (states[k + 1] - predicted[k + 1])
        sums.zx[:n] += J @ covs[k + 1]
        covs[k] += J @ (covs[k + 1] - predicted_cov[k + 1]) @ J.T
    whole = covs.sum(axis=0)
    sums.zz[:n, :n] += whole - covs[-1]
    sums.xx += whole - covs[0]
    sums.gg[:n, :n] += whole
    # A missing y is estimated, too: y = C x + D u + v, so that E y^2 and E z y have its covariance.
    _add(sums, states, np.where(present, y, states @ model.C.T + through), u)
    for i in np.flatnonzero(~present.all(axis=0)):
        without = covs[~present[:, i]]
        sums.gy[:n, i] += without.sum(axis=0) @ model.C[i]
        sums.yy[i] += model.C[i] @ without.sum(axis=0) @ model.C[i] + len(without) * model.r[i]
