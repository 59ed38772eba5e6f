"""Stage 1 of the cold start: robust regression on groups of readings, from blunt to sharp.

Every row is scaled by one unit per channel, its root mean square deviation over the window, and not by its
own deviation: later rows carry process noise, and scaling it away would let the first samples, which have
little redundancy of their own, absorb an attack. In an orthonormal basis Z of what the state can do, with f
the deviation of a row in its unit,

    v = (3 f)^2 + eps^2,   t_g = mean over the group of res^2 / v,   w = 1 / (v (1 + t_g)),   eps <- 0.7 eps

which is iteratively reweighted least squares for the sum of log(1 + t_g). eps starts at the least-squares
residual. Groups of protected sensors keep t_g = 0, and nearly their own v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

SHRINK = 0.7
#: Deviations of its noise within which a residual counts in full.
CORE = 3.0
#: eps stops at this share of the smallest deviation.
FLOOR = 0.1
#: Iterations after eps has reached its floor.
SETTLING = 20
#: Relative change of the weights at which the iteration has settled.
SETTLED = 1e-3
#: Ridge on the normal equations, relative to the largest weight; stage 2 is exact.
RIDGE = 1e-13
#: Share of eps by which protected groups are blunted; zero would drown all others in rounding.
PROTECTED = 1e-3


@dataclass(frozen=True, eq=False)
class Groups:
    """Which rows lie or tell the truth together.

    Attributes:
        of: (rows,), the group of every row. count: (G,), rows per group.
        protected: (G,), True for groups that nobody can tamper with.
    """

    of: Index
    count: Index
    protected: Bool

    def mean(self, values: Float) -> Float:
        """Mean over every group, (G,)."""
        means: Float = np.bincount(self.of, values, minlength=len(self.count)) / self.count
        return means


def anneal(O: Float, y: Float, f: Float, groups: Groups, use: Bool) -> Float:
    """How far every group is from the robust fit: mean of (residual / deviation)^2, (G,).

    Args:
        O: (rows, n), y: (rows,), f: (rows,), all in the unit of the row's channel.
        use: (G,), groups that take part in the fit.
    """
    Z: Float = np.asarray(linalg.qr(O, mode="economic", check_finite=False)[0], dtype=np.float64)
    taken = use[groups.of].astype(np.float64)
    w: Float = taken.copy()
    f2, least = (CORE * f) ** 2, CORE * float(f.min())
    res = _residual(Z, y, w)
    eps = float(np.sqrt(np.sum(taken * res**2) / taken.sum())) + least
    steps = int(np.ceil(np.log(eps / (FLOOR * least)) / -np.log(SHRINK))) + SETTLING
    for _ in range(steps):
        before, w = w, taken * _weights(res, f2, eps, groups)
        if eps < 2 * FLOOR * least and np.abs(w - before).max() < SETTLED * w.max():
            break
        eps = max(SHRINK * eps, FLOOR * least)
        res = _residual(Z, y, w)
    return groups.mean((res / f) ** 2)


def _weights(res: Float, f2: Float, eps: float, groups: Groups) -> Float:
    """1 / (v (1 + t_g)), times a number that keeps them near one."""
    safe = groups.protected[groups.of]
    v = f2 + np.where(safe, PROTECTED * eps, eps) ** 2
    t = np.where(safe, 0.0, groups.mean(res**2 / v)[groups.of])
    weights: Float = (float(f2.mean()) + eps**2) / (v * (1 + t))
    return weights


def _residual(Z: Float, y: Float, w: Float) -> Float:
    """Return y - Z t for the t that minimises the sum of w (y - Z t)^2."""
    W = w / w.max()
    J = Z.T @ (W[:, np.newaxis] * Z)
    J.flat[:: len(J) + 1] += RIDGE
    _, t, failed = linalg.lapack.dposv(J, Z.T @ (W * y))
    if failed:
        raise linalg.LinAlgError("the normal equations are not positive definite")
    residual: Float = y - Z @ t
    return residual
