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

from securestate.errors import InputError
from securestate.estimators._smoother import smooth
from securestate.identification.forms import (
    Independent,
    Predictor,
    Record,
    Stack,
    Stationary,
    innovations_of,
    log_density,
    long_run,
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


def expect(model: Independent, stack: Stack) -> Moments:
    """E-step on segments without missing samples, each long enough for the filter to be stationary.

    Raises:
        LinAlgError: the model has no stationary filter.
    """
    steady = stationary(model)
    P, L, A, n = steady.P, steady.L, model.A, model.n
    filtered = symmetric(P - L @ model.C @ P)
    J = np.asarray(np.linalg.solve(P, A @ filtered).T, dtype=np.float64)
    smoothed = long_run(J, filtered - J @ P @ J.T)
    e, x = Predictor(innovations_of(model, steady))(stack)
    # x[k|N] = x[k|k] + J (x[k+1|N] - x[k+1|k]), from the end of every segment backwards
    states = x + e @ L.T
    inner = np.ones(len(x), dtype=np.bool_)
    inner[stack.lasts] = False
    states[:-1][inner[:-1]] -= x[1:][inner[:-1]] @ J.T
    states = stack.backwards(J, states)
    sums = Moments.none(model)
    sums.likelihood = _likelihood(model, steady, e)
    _add(sums, states, stack)
    sums.zz[:n, :n] += sums.transitions * smoothed
    sums.zx[:n] += sums.transitions * (smoothed @ J.T).T
    sums.xx += sums.transitions * smoothed
    sums.gg[:n, :n] += sums.samples * smoothed
    return sums


def _likelihood(model: Independent, steady: Stationary, e: Array) -> float:
    """Sum of log N(e; 0, S), S = C P C' + R; of many channels by the inverse of the smaller matrix."""
    m, n = model.C.shape
    if m < 2 * n:
        return float(np.sum(log_density(e, steady.S)))
    # e' S^-1 e = e' R^-1 e - h' (P^-1 + C' R^-1 C)^-1 h,   h = C' R^-1 e
    weighed = model.C / model.r[:, None]
    information = np.linalg.inv(steady.P) + model.C.T @ weighed
    h = e @ weighed
    squares = float(np.sum(np.einsum("ki,ki->i", e, e) / model.r))
    squares -= float(np.einsum("ki,ki->", h, np.linalg.solve(information, h.T).T))
    _, size = np.linalg.slogdet(2 * np.pi * steady.S)
    return -0.5 * (squares + len(e) * float(size))


def _add(sums: Moments, states: Array, stack: Stack) -> None:
    """Add the products of smoothed means; nothing leads from one segment to the next."""
    z = np.hstack([states, stack.u])
    first, last = z[stack.firsts], z[stack.lasts]
    n = states.shape[1]
    whole = z.T @ z
    sums.gg += whole
    sums.zz += whole - last.T @ last
    sums.xx += (whole - first.T @ first)[:n, :n]
    sums.zx += z[:-1].T @ states[1:] - last[:-1].T @ first[1:, :n]
    sums.gy += z.T @ stack.y
    sums.yy += np.sum(stack.y**2, axis=0)
    sums.transitions += len(z) - len(first)
    sums.samples += len(z)


def expect_with_gaps(model: Independent, record: Record) -> Moments:
    """E-step with missing channels (NaN): the exact filter and smoother, whose covariances vary in time."""
    sums = Moments.none(model)
    # The start is not known: its covariance is that of the state in the long run, as `Predictor` assumes.
    start = spread(model.A, model.Q + model.B @ model.B.T)
    for y, u in record:
        _add_smoothed(model, start, y, u, sums)
    return sums


def _add_smoothed(model: Independent, start: Array, y: Array, u: Array, sums: Moments) -> None:
    """One segment of `expect_with_gaps`."""
    n, through = model.n, u @ model.D.T
    try:
        found = smooth(model.A, model.C, model.Q, model.r, start, u @ model.B.T, y - through)
    except InputError as reason:
        raise np.linalg.LinAlgError(str(reason)) from None
    sums.likelihood += found.likelihood
    sums.zx[:n] += found.crossed
    sums.zz[:n, :n] += found.whole - found.last
    sums.xx += found.whole - found.first
    sums.gg[:n, :n] += found.whole
    # A missing y is estimated, too: y = C x + D u + v, so that E y^2 and E z y have its covariance.
    missing = np.isnan(y)
    _add(sums, found.states, Stack([(np.where(missing, found.states @ model.C.T + through, y), u)]))
    sums.gy[:n] += np.einsum("mij,mj->im", found.absent, model.C)
    sums.yy += np.einsum("mi,mij,mj->m", model.C, found.absent, model.C) + missing.sum(axis=0) * model.r
