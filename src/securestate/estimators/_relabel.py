"""Stages 2 and 3 of the cold start: exact tests with the full covariance, and least squares on honest rows.

    Omega = Sigma^-1 - Sigma^-1 O (O' Sigma^-1 O)^-1 O' Sigma^-1,   a = Omega y        on the honest rows
    d_g^2 = a_g' Omega_gg^-1 a_g                                      for an honest group, chi-square
    d_g^2 = E_g' V_g^-1 E_g                                           for another one, E its reading minus

what the honest rows predict, V the covariance of that. Both ask the same: how far is this group from what the
others say? Where the others say nothing about a direction of Omega_gg, that direction is not tested.
Rows are in units of their own deviation, so that Sigma is a correlation matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from securestate.estimators._anneal import Groups

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

#: Probability with which the test of an honest group fails.
ALPHA = 1e-4
#: Rounds of relabelling at most.
ROUNDS = 20
#: Smallest singular value of O, columns scaled, relative to the largest, that still determines the state.
RANK = 1e-10
#: Share of a direction's variance that others must explain to test it.
TESTED = 1e-8
#: Added to the diagonal of a correlation matrix in turn until it has a Cholesky factor.
JITTER = (0.0, 1e-13, 1e-10)


@dataclass(frozen=True, eq=False)
class Rows:
    """Readings that arrived, in units of their own deviation: O (rows, n), Sigma (rows, rows), y (rows,)."""

    O: Float
    Sigma: Float
    y: Float

    def with_prior(self, O: Float, width: float) -> Rows:
        """The same beside x0 ~ 0, so wide that readings O x0 are off by `width` of their deviations."""
        size, n = _column_sizes(O), O.shape[1]
        prior = np.vstack([self.O, np.diag(size) / width])
        return Rows(prior, linalg.block_diag(self.Sigma, np.eye(n)), np.append(self.y, np.zeros(n)))


@dataclass(frozen=True, eq=False)
class Fit:
    """Generalised least squares on the rows h.

    Attributes:
        L: Cholesky factor of Sigma_hh, inverted; L L' is not Sigma but L' L = Sigma_hh^-1.
        Q, R: L O_h = Q R.
        e: L (y_h - O_h x0), the whitened residual.
    """

    rows: Rows
    h: Index
    L: Float
    Q: Float
    R: Float
    x0: Float
    e: Float

    @property
    def statistic(self) -> float:
        """The statistic y' Omega y, chi-square with `freedom` degrees if all rows are honest."""
        return float(self.e @ self.e)

    @property
    def freedom(self) -> int:
        """Residual degrees of freedom."""
        return len(self.h) - len(self.x0)

    @property
    def rounding(self) -> float:
        """What rounding can do to an entry of e."""
        return float(
            np.finfo(np.float64).eps * (np.abs(self.L) @ np.abs(self.rows.y[self.h])).max(initial=0.0)
        )

    @cached_property
    def X(self) -> Float:
        """L O_h."""
        return self.Q @ self.R

    @cached_property
    def a(self) -> Float:
        """Omega y."""
        return self.L.T @ self.e

    def predict(self, F: Float, cross: Float) -> tuple[Float, Float, Float]:
        """F x0 + something of covariance `cross` (k, rows) with y: mean (k,), K and B for its covariance.

        The covariance is that of the something minus K K' plus B B', K (k, h) and B (k, n).
        """
        K = cross[:, self.h] @ self.L.T
        rest = F - K @ self.X
        B = linalg.solve_triangular(self.R, rest.T, trans="T", check_finite=False).T
        return F @ self.x0 + K @ self.e, K, B


def least_squares(rows: Rows, h: Index) -> Fit | None:
    """The fit on the rows h, or None if these do not determine the state."""
    O = rows.O[h]
    if len(h) < O.shape[1]:
        return None
    L = _inverse_factor(rows.Sigma[np.ix_(h, h)])
    if L is None:
        return None
    white, size = L @ O, _column_sizes(O)
    Q, R = np.linalg.qr(white / size)
    if not _well_conditioned(R):
        return None
    b = L @ rows.y[h]
    x0 = linalg.solve_triangular(R, Q.T @ b, check_finite=False) / size
    return Fit(rows, h, L, Q, R * size, x0, b - Q @ (Q.T @ b))


def determines(O: Float) -> bool:
    """Whether y = O x0 has one solution at most, rounding aside."""
    if len(O) < O.shape[1]:
        return False
    return _well_conditioned(linalg.qr(O / _column_sizes(O), mode="r", check_finite=False)[0][: O.shape[1]])


def _well_conditioned(R: NDArray[Any]) -> bool:
    sizes = np.linalg.svd(np.asarray(R, dtype=np.float64), compute_uv=False)
    return bool(sizes[-1] > RANK * sizes[0])


def _column_sizes(O: Float) -> Float:
    sizes = np.linalg.norm(O, axis=0)
    return np.where(sizes > 0, sizes, 1.0)


def _inverse_factor(Sigma: Float) -> Float | None:
    eye = np.eye(len(Sigma))
    for jitter in JITTER:
        try:
            L = linalg.cholesky(Sigma + jitter * eye, lower=True, check_finite=False)
        except linalg.LinAlgError:
            continue
        inverse: Float = linalg.solve_triangular(L, eye, lower=True, check_finite=False)
        return inverse
    return None


@dataclass(frozen=True, eq=False)
class Labels:
    """Who is honest, from a fit to those who are.

    Attributes:
        honest: (G,). excess: (G,), d_g^2 over its quantile; above 1 is suspect.
        tested: (G,), False where a direction of the group is checked by nobody else.
    """

    honest: Bool
    fit: Fit
    excess: Float
    tested: Bool


def relabel(rows: Rows, groups: Groups, honest: Bool, allowed: Bool) -> Labels | None:
    """Test every group against the honest ones until nothing changes; None if `honest` determine nothing.

    At most half of the newly accused, the worse ones, are dropped at once: a liar makes others look bad.
    """
    last, seen = None, set()
    for _ in range(ROUNDS):
        seen.add(honest.tobytes())
        fit = least_squares(rows, np.flatnonzero(honest[groups.of]))
        if fit is None:
            break
        excess, tested = _test(fit, groups, honest)
        last = Labels(honest, fit, excess, tested)
        passed = ((excess < 1) | groups.protected) & allowed
        accused = np.flatnonzero(honest & ~passed)
        passed[accused[np.argsort(excess[accused])[: len(accused) // 2]]] = True
        if passed.tobytes() in seen:
            break
        honest = passed
    return last


def _test(fit: Fit, groups: Groups, honest: Bool) -> tuple[Float, Bool]:
    """d_g^2 over its quantile, and whether all directions were tested, of every group."""
    if groups.count.max() == 1:
        d2, freedom = _distances_of_rows(fit, groups, honest)
    else:
        d2, freedom = _distances_of_blocks(fit, groups, honest)
    return d2 / special.chdtri(np.maximum(freedom, 1), ALPHA), freedom == groups.count


def _distances_of_rows(fit: Fit, groups: Groups, honest: Bool) -> tuple[Float, Index]:
    """d_g^2 and its degrees of freedom where every group is one row."""
    d2, freedom = np.zeros(len(honest)), np.ones(len(honest), dtype=np.int64)
    known = np.einsum("ij,ij->j", fit.L, fit.L)
    omega = known - np.einsum("ij,ij->j", *[fit.Q.T @ fit.L] * 2)
    tested = omega > TESTED * known
    own = groups.of[fit.h]
    d2[own] = np.where(tested, fit.a**2 / np.where(tested, omega, 1.0), 0.0)
    freedom[own] = tested
    out = np.flatnonzero(~honest[groups.of])
    E, V = deviation(fit, out)
    d2[groups.of[out]] = E**2 / V
    return d2, freedom


def _distances_of_blocks(fit: Fit, groups: Groups, honest: Bool) -> tuple[Float, Index]:
    """d_g^2 and its degrees of freedom."""
    d2, freedom = np.zeros(len(honest)), groups.count.copy()
    QL, place = fit.Q.T @ fit.L, np.empty(len(groups.of), dtype=np.int64)
    out = np.flatnonzero(~honest[groups.of])
    place[fit.h], place[out] = np.arange(len(fit.h)), np.arange(len(out))
    mean, K, B = fit.predict(fit.rows.O[out], fit.rows.Sigma[out])
    E = fit.rows.y[out] - mean
    for g, rows in enumerate(members(groups.of, len(honest))):
        p = place[rows]
        if honest[g]:
            known = fit.L[:, p].T @ fit.L[:, p]
            d2[g], freedom[g] = _leave_out(known, known - QL[:, p].T @ QL[:, p], fit.a[p])
        else:
            d2[g] = _from_outside(fit.rows.Sigma[np.ix_(rows, rows)] - K[p] @ K[p].T, B[p], E[p])
    return d2, freedom


def _leave_out(known: Float, omega: Float, a: Float) -> tuple[float, int]:
    """Return a' omega^-1 a over the directions in which omega is not zero beside `known`."""
    try:
        values, vectors = linalg.eigh(omega, known, check_finite=False)
    except linalg.LinAlgError:  # `known` is singular to rounding
        return 0.0, 0
    tested = values > TESTED
    along = vectors[:, tested].T @ a
    return float(np.sum(along**2 / values[tested])), int(tested.sum())


def _from_outside(S: Float, B: Float, E: Float) -> float:
    """E' (S + B B')^-1 E, S the covariance if x0 were known; B may be huge where x0 is hardly known."""
    L = _inverse_factor(S)
    if L is None:  # what is left after the others is rounding
        L = np.eye(len(S)) / JITTER[-1] ** 0.5
    e = L @ E
    U, s, _ = linalg.svd(L @ B, full_matrices=False, check_finite=False)
    along = U.T @ e
    return float(np.sum((e - U @ along) ** 2) + np.sum(along**2 / (1 + s**2)))


def deviation(fit: Fit, out: Index) -> tuple[Float, Float]:
    """Readings `out` minus what the fit predicts, and the variances of that if they are honest."""
    rows = fit.rows
    mean, K, B = fit.predict(rows.O[out], rows.Sigma[out])
    own = np.diag(rows.Sigma)[out] - np.einsum("ij,ij->i", K, K)
    return rows.y[out] - mean, np.maximum(own, JITTER[-1]) + np.einsum("ij,ij->i", B, B)


def unchecked(fit: Fit, owner: Index, count: int) -> Bool:
    """Which owners of honest rows nobody else can check, (count,): the others do not determine the state."""
    QL, alone = fit.Q.T @ fit.L, np.zeros(count, dtype=np.bool_)
    for i, p in enumerate(members(owner[fit.h], count)):
        known = fit.L[:, p].T @ fit.L[:, p]
        freedom = _leave_out(known, known - QL[:, p].T @ QL[:, p], np.zeros(len(p)))[1] if len(p) else 0
        alone[i] = freedom < len(p)
    return alone


def members(of: Index, count: int) -> list[Index]:
    """The places of every one of `count` owners."""
    order = np.argsort(of, kind="stable")
    return np.split(order, np.cumsum(np.bincount(of, minlength=count))[:-1])
