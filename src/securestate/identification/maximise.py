"""Maximum likelihood for an independent model: a few EM steps, then a quasi-Newton method on the same
moments.

EM is safe far from the optimum and slow near it; L-BFGS is the other way round. Both get the gradient from
the E-step (`expectation`). Positive covariances are parametrised, Q = sum of L L' + floor over its free
blocks and r = floor + exp(.), so that no step can leave them. Entries may be held fixed.

References:
    shumway1982, dempster1977: EM. segal1989: the gradient of a likelihood from a smoother.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy  # loads `optimize` where it is first used: few commands need it
from numpy.typing import NDArray

from securestate.identification.expectation import Moments, expect, expect_with_gaps
from securestate.identification.forms import (
    EDGE,
    Independent,
    Record,
    Stack,
    radius,
    spread,
    symmetric,
)

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Progress = Callable[[int, int], None]

#: Least process noise in every free direction, where the state has variance one.
LEAST_PROCESS = 1e-7

#: What an impossible model costs, per sample; above any likelihood that occurs.
IMPOSSIBLE = 1e10


@final
@dataclass(frozen=True, eq=False)
class Freedom:
    """Which entries may change: True where free, in the shapes of A, B, C, D and r; `blocks`: of Q.

    `limit`: largest |eigenvalue| of A. `own_coordinates`: the state keeps its meaning whatever is free.

    Q is free in blocks: index sets without common states, each with a covariance of its own; entries between
    blocks and outside of them stay.
    """

    A: Flags
    B: Flags
    C: Flags
    D: Flags
    blocks: tuple[NDArray[np.int64], ...]
    r: Flags
    limit: float = EDGE
    own_coordinates: bool = False

    @classmethod
    def all(cls, model: Independent, feedthrough: bool) -> Freedom:
        """Everything is free, D only with feedthrough."""
        A, B, C = (np.ones(X.shape, dtype=np.bool_) for X in (model.A, model.B, model.C))
        D = np.full(model.D.shape, feedthrough, dtype=np.bool_)
        return cls(A, B, C, D, (np.arange(model.n),), np.ones(len(model.r), dtype=np.bool_))

    @property
    def coordinates(self) -> bool:
        """Whether the state's coordinates are free to be chosen."""
        if self.own_coordinates:
            return False
        return bool(self.A.all() and self.B.all() and self.C.all()) and [len(b) for b in self.blocks] == [
            len(self.A)
        ]


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model.

    Attributes:
        model: in balanced coordinates if coordinates were free.
        likelihoods: log-likelihood in nats per sample before every step taken and after the last; they never
            fall.
    """

    model: Independent
    likelihoods: tuple[float, ...]


def maximise(
    model: Independent,
    record: Record,
    freedom: Freedom,
    floor: Array,
    *,
    em: int = 5,
    steps: int = 150,
    gaps: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """Raise the likelihood of a record from `model` on; never returns a less likely model than that.

    Args:
        model: where to start. record: segments; with NaN only if `gaps`.
        freedom: what may change. floor: least variance of every sensor's noise, (m,).
        em, steps: at most so many steps of EM and of L-BFGS.
        gaps: use the exact filter for missing channels, about fifty times slower.
        progress: called with steps done and steps at most.
    Raises:
        LinAlgError: `model` has no stationary filter.
    """
    evaluate = _evaluation(record, gaps)
    samples = sum(len(y) for y, _ in record)
    tell = progress or (lambda _done, _all: None)
    best = current = _placed(model, freedom)
    heard = evaluate(current)
    likelihoods = [heard.likelihood / samples]
    for k in range(em):
        current = _placed(_m_step(current, heard, freedom, floor), freedom)
        try:
            heard = evaluate(current)
        except np.linalg.LinAlgError:
            break
        tell(k + 1, em + steps)
        if not heard.likelihood / samples > likelihoods[-1]:
            break
        best = current
        likelihoods.append(heard.likelihood / samples)
    if steps:
        task = _Task(best, freedom, floor, evaluate, samples)
        found, climbed = task.climb(steps, lambda k: tell(em + k, em + steps))
        if climbed and climbed[-1] > likelihoods[-1]:
            best = found
            for value in climbed:  # its first steps may be below where EM ended
                likelihoods += [value] if value > likelihoods[-1] else []
    return Fit(_placed(best, freedom), tuple(likelihoods))


def _evaluation(record: Record, gaps: bool) -> Callable[[Independent], Moments]:
    """The E-step on this record, as a function of the model."""
    if gaps:
        return lambda model: expect_with_gaps(model, record)
    stack = Stack(record)
    return lambda model: expect(model, stack)


def balanced(model: Independent) -> Independent:
    """The same model with the state's stationary covariance, as far as noise drives it, equal to one."""
    X = spread(model.A, model.Q)
    X = X + 1e-12 * np.trace(X) * np.eye(model.n)
    return model.turned(np.linalg.cholesky(X))


def _placed(model: Independent, freedom: Freedom) -> Independent:
    """Balanced coordinates and a stable A, as far as these are free."""
    if not freedom.coordinates:
        return model
    size = radius(model.A)
    inside = replace(model, A=model.A * (freedom.limit / size)) if size > freedom.limit else model
    return balanced(inside)


# The M-step
# --------------------------------------------------------------------------------------------------------


def _m_step(model: Independent, heard: Moments, freedom: Freedom, floor: Array) -> Independent:
    """Maximise the expected log-likelihood of the complete data: [A B] for the old Q, then Q, [C D], r."""
    n = model.n
    AB = np.hstack([model.A, model.B])
    CD = np.hstack([model.C, model.D])
    AB = _regress_jointly(AB, np.hstack([freedom.A, freedom.B]), heard.zz, heard.zx, model.Q)
    CD = _regress(CD, np.hstack([freedom.C, freedom.D]), heard.gg, heard.gy)
    Q = model.Q.copy()
    left = heard.process_noise(AB) / heard.transitions
    for block in freedom.blocks:
        values, V = np.linalg.eigh(left[np.ix_(block, block)])
        Q[np.ix_(block, block)] = (V * np.maximum(values, LEAST_PROCESS)) @ V.T
    noise = np.maximum(heard.sensor_noise(CD) / heard.samples, floor)
    return Independent(
        AB[:, :n], AB[:, n:], CD[:, :n], CD[:, n:], symmetric(Q), np.where(freedom.r, noise, model.r)
    )


def _regress(X: Array, free: Flags, zz: Array, zy: Array) -> Array:
    """Least squares y = X z row by row, for the free entries."""
    if free.all():
        return np.asarray(np.linalg.solve(zz, zy).T)
    fitted = X.copy()
    for i, row in enumerate(free):
        if row.any():
            known = zz[np.ix_(row, ~row)] @ X[i, ~row]
            fitted[i, row] = np.linalg.solve(zz[np.ix_(row, row)], zy[row, i] - known)
    return fitted


def _regress_jointly(X: Array, free: Flags, zz: Array, zy: Array, Q: Array) -> Array:
    """The same with errors correlated between rows, covariance Q, which matters if some entries are fixed."""
    if free.all():
        return np.asarray(np.linalg.solve(zz, zy).T)
    fitted = X.copy()
    i, j = np.nonzero(free)
    if len(i):
        W = np.linalg.inv(_positive(Q))
        target = W @ (zy.T - np.where(free, 0.0, X) @ zz)
        fitted[i, j] = np.linalg.solve(W[np.ix_(i, i)] * zz[np.ix_(j, j)], target[i, j])
    return fitted


def _positive(Q: Array) -> Array:
    """Q, or Q with the least process noise added where it has none."""
    scale = max(float(np.max(np.diag(Q))), 1e-300)
    singular = np.linalg.eigvalsh(Q)[0] <= 1e-10 * scale
    return Q + LEAST_PROCESS * scale * np.eye(len(Q)) if singular else Q


# L-BFGS
# ------------------------------------------------------------------------------------------------------------


@final
class _Task:
    """The likelihood as a function of a vector of parameters.

    Rows of C and D count in units of their sensor's noise, so that all parameters are of similar size.
    """

    def __init__(
        self,
        model: Independent,
        freedom: Freedom,
        floor: Array,
        evaluate: Callable[[Independent], Moments],
        samples: int,
    ) -> None:
        self.model, self.freedom, self.floor = model, freedom, floor
        self.evaluate, self.samples = evaluate, samples
        self.size = np.sqrt(model.r)[:, None]

    def climb(self, steps: int, tell: Callable[[int], None]) -> tuple[Independent, list[float]]:
        """Run L-BFGS; return its model and the likelihood per sample after every step."""
        values: list[float] = []

        def after(intermediate_result: scipy.optimize.OptimizeResult) -> None:
            values.append(-float(intermediate_result.fun))
            tell(len(values))

        found = scipy.optimize.minimize(
            self,
            self.pack(),
            jac=True,
            method="L-BFGS-B",
            callback=after,
            options={
                "maxiter": steps,
                "maxfun": steps + steps // 2 + 5,
                "maxcor": 25,
                "ftol": 1e-9,
                "gtol": 1e-6,
            },
        )
        return self.unpack(found.x), values

    def pack(self) -> Array:
        """The parameters of the model to start from."""
        model, free = self.model, self.freedom
        factors = [_factor(model.Q[np.ix_(block, block)]) for block in free.blocks]
        return np.concatenate(
            [
                model.A[free.A],
                model.B[free.B],
                (model.C / self.size)[free.C],
                (model.D / self.size)[free.D],
                *(L[np.tril_indices(len(L))] for L in factors),
                np.log(np.maximum(model.r - self.floor, 1e-8))[free.r],
            ]
        )

    def unpack(self, x: Array) -> Independent:
        """The model of these parameters."""
        model, free = self.model, self.freedom
        parts = self._parts(x)
        A, B = _filled(model.A, free.A, next(parts)), _filled(model.B, free.B, next(parts))
        C = _filled(model.C / self.size, free.C, next(parts)) * self.size
        D = _filled(model.D / self.size, free.D, next(parts)) * self.size
        Q = model.Q.copy()
        for block in free.blocks:
            L = _lower(len(block), next(parts))
            Q[np.ix_(block, block)] = L @ L.T + LEAST_PROCESS * np.eye(len(block))
        r = _filled(model.r, free.r, self.floor[free.r] + np.exp(next(parts)))
        return Independent(A, B, C, D, Q, r)

    def _parts(self, x: Array) -> Iterator[Array]:
        free = self.freedom
        blocks = [len(block) * (len(block) + 1) // 2 for block in free.blocks]
        lengths = [int(f.sum()) for f in (free.A, free.B, free.C, free.D)] + blocks + [int(free.r.sum())]
        return iter(np.split(x, np.cumsum(lengths)[:-1]))

    def __call__(self, x: Array) -> tuple[float, Array]:
        """Minus the log-likelihood per sample, and its gradient."""
        impossible = IMPOSSIBLE, np.zeros_like(x)
        if not np.all(np.isfinite(x)) or np.max(np.abs(x), initial=0.0) > 1e8:
            return impossible
        with np.errstate(over="ignore"):
            model = self.unpack(x)
        if not np.all(model.r < 1e9) or radius(model.A) >= self.freedom.limit:
            return impossible
        try:
            heard = self.evaluate(model)
            slope = self._slope(x, model, heard)
        except (np.linalg.LinAlgError, ValueError):
            return impossible
        if not (np.isfinite(heard.likelihood) and np.all(np.isfinite(slope))):
            return impossible
        return -heard.likelihood / self.samples, -slope / self.samples

    def _slope(self, x: Array, model: Independent, heard: Moments) -> Array:
        """The gradient of the log-likelihood, from the moments of the complete data."""
        free, n, r = self.freedom, model.n, model.r
        W = np.linalg.inv(_positive(model.Q))
        AB, CD = np.hstack([model.A, model.B]), np.hstack([model.C, model.D])
        by_AB = W @ (heard.zx.T - AB @ heard.zz)
        by_CD = (heard.gy.T - CD @ heard.gg) / r[:, None] * self.size
        by_Q = 0.5 * (W @ heard.process_noise(AB) @ W - heard.transitions * W)
        by_r = 0.5 * (heard.sensor_noise(CD) / r**2 - heard.samples / r)
        *_, logs = self._parts(x)
        lower = list(self._parts(x))[4:-1]
        return np.concatenate(
            [
                by_AB[:, :n][free.A],
                by_AB[:, n:][free.B],
                by_CD[:, :n][free.C],
                by_CD[:, n:][free.D],
                *(
                    (2 * symmetric(by_Q)[np.ix_(block, block)] @ _lower(len(block), entries))[
                        np.tril_indices(len(block))
                    ]
                    for block, entries in zip(free.blocks, lower, strict=True)
                ),
                by_r[free.r] * np.exp(logs),
            ]
        )


def _filled(X: Array, free: Flags, values: Array) -> Array:
    filled = X.copy()
    filled[free] = values
    return filled


def _lower(n: int, entries: Array) -> Array:
    L = np.zeros((n, n))
    L[np.tril_indices(n)] = entries
    return L


def _factor(Q: Array) -> Array:
    """L with L L' = Q less the least process noise."""
    values, V = np.linalg.eigh(Q)
    return np.asarray(np.linalg.cholesky(symmetric((V * np.maximum(values - LEAST_PROCESS, 1e-9)) @ V.T)))
