"""Models of every order from one record: the predictor subspace, consistent in closed loop.

The regression y[k] on the past (`lags`) gives the predictor's Markov parameters. Stacked over f steps ahead
they map the past onto what it says of the future, and the leading singular directions of that map are the
state:

    H = W G chol(Phi) = U diag(s) V',   x[k] = diag(s)^-1 U' W G past[k]

With states known, A, B, C, D, K are regressions and S is what is left.

References:
    chiuso2007: PBSID_opt. jansson2003: SSARX. The left weight W = S^-1/2 is that of canonical variates.
"""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate.identification.forms import EDGE, Innovations, Record, radius, symmetric
from securestate.identification.lags import lag_moments, ridged

Array = NDArray[np.float64]

#: Largest |eigenvalue| of A - K C: the predictor forgets its start.
FORGETS = 0.9995

#: From this size on only the leading singular directions are computed, and so many of them.
LARGE, LEADING = 600, 60


@final
class Subspace:
    """What a record says about the state, for all orders at once."""

    def __init__(self, record: Record, p: int, feedthrough: bool, edge: float = EDGE) -> None:
        self.p, self.feedthrough, self.edge = p, feedthrough, edge
        self.m, self.q = record[0][0].shape[1], record[0][1].shape[1]
        self.width = self.m + self.q
        self.M, self.samples = lag_moments(record, p)
        self.of_u, self.of_y = np.arange(self.q), np.arange(self.q, self.width)
        self.past = np.arange(self.width, len(self.M))
        markov, S = self._regression()
        W = np.linalg.inv(np.linalg.cholesky(S + 1e-9 * np.eye(self.m)))
        self.weighted = (W @ markov).reshape(-1, p * self.width)
        root = np.linalg.cholesky(ridged(self.M[np.ix_(self.past, self.past)]))
        self.U, self.values = _leading(self.weighted @ root)

    @property
    def largest_order(self) -> int:
        """Orders up to this one have a model."""
        return len(self.values)

    def _regression(self) -> tuple[Array, Array]:
        """The map from the past to y up to p - 1 steps ahead, (p, m, p width), and the covariance left, (m,
        m).
        """
        M, m, p, width = self.M, self.m, self.p, self.width
        regressors = np.concatenate([self.past, self.of_u]) if self.feedthrough else self.past
        G, c = M[np.ix_(regressors, regressors)], M[np.ix_(regressors, self.of_y)]
        theta = linalg.cho_solve(linalg.cho_factor(ridged(G)), c).T
        S = M[np.ix_(self.of_y, self.of_y)] - theta @ c - c.T @ theta.T + theta @ G @ theta.T
        ahead = np.zeros((p, m, p * width))
        for j in range(p):
            ahead[j, :, : (p - j) * width] = theta[:, j * width : p * width]
        return ahead, symmetric(S)

    def model(self, n: int) -> Innovations:
        """The innovations form of order n; A is kept inside the circle of `edge`, A - K C inside `FORGETS`.

        A state now and a sample later are both linear in [z[k], ..., z[k-p]], whose moments are M.
        """
        T = (self.U[:, :n].T @ self.weighted) / self.values[:n, None]
        size, width = len(self.M), self.width
        now, later = np.zeros((n, size)), np.zeros((n, size))
        now[:, width:], later[:, :-width] = T, T
        u, y = np.eye(size)[self.of_u], np.eye(size)[self.of_y]
        CD = self._regress(y, np.vstack([now, u]) if self.feedthrough else now)
        C, D = CD[:, :n], CD[:, n:] if self.feedthrough else np.zeros((self.m, self.q))
        e = y - C @ now - D @ u
        ABK = self._regress(later, np.vstack([now, u, e]))
        A, B, K = ABK[:, :n], ABK[:, n : n + self.q], ABK[:, n + self.q :]
        A = A * min(1.0, self.edge / max(radius(A), 1e-300))
        while radius(A - K @ C) > FORGETS and np.max(np.abs(K)) > 1e-9:
            K = K * 0.9
        return Innovations(A, B, C, D, K, symmetric(e @ self.M @ e.T))

    def _regress(self, target: Array, on: Array) -> Array:
        moments = on @ self.M @ on.T + 1e-10 * np.eye(len(on))
        return np.asarray(np.linalg.solve(moments, on @ self.M @ target.T).T)


def _leading(H: Array) -> tuple[Array, Array]:
    """Leading left singular vectors and values; of a large matrix by random projections with a fixed seed.

    References:
        halko2011.
    """
    if min(H.shape) <= LARGE:
        U, values, _ = linalg.svd(H, full_matrices=False)
        return U, values
    probe = np.random.default_rng(0).standard_normal((H.shape[1], LEADING + 20))
    image = H @ probe
    for _ in range(2):
        image = H @ (H.T @ np.linalg.qr(image)[0])
    basis = np.linalg.qr(image)[0]
    U, values, _ = linalg.svd(basis.T @ H, full_matrices=False)
    return basis @ U, values
