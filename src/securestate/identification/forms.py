"""The two forms of a linear model, and what both predict.

Innovations form: one noise, which says all of the output's law but cannot be told apart by sensor:

    x[k+1] = A x[k] + B u[k] + K e[k],   y[k] = C x[k] + D u[k] + e[k],   e ~ N(0, S)

Independent noises, the form of a `Plant`: every sensor has its own, so that the lie of one does not look like
the noise of another:

    x[k+1] = A x[k] + B u[k] + w[k],     y[k] = C x[k] + D u[k] + v[k],   w ~ N(0, Q),  v ~ N(0, diag r)

Everything here is in normalised units. A record is a list of segments: pairs y (N, m), u (N, q).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate._steady_state import doubling
from securestate.identification._scan import Scan

Array = NDArray[np.float64]
Segment = tuple[Array, Array]
Record = Sequence[Segment]

#: Samples over which the unknown start of a segment is felt at most.
MEMORY = 256

#: Largest |eigenvalue| with which a stationary covariance is asked for.
EDGE = 0.9999


#: Fewer states than this make one linear system of n^2 unknowns.
FEW = 10


@final
class Stack:
    """A record without gaps in one array, and plans for recursions forwards and backwards.

    Attributes:
        y (N, m), u (N, q): of all segments, one after the other.
        bounds: where segments begin, and N at the end.
    """

    def __init__(self, record: Record) -> None:
        self.y = np.vstack([y for y, _ in record])
        self.u = np.vstack([u for _, u in record])
        lengths = [len(y) for y, _ in record]
        self.bounds = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        self.forwards, self._reversed = Scan(lengths), Scan(lengths[::-1])
        self.firsts, self.lasts = self.bounds[:-1], self.bounds[1:] - 1

    def backwards(self, J: Array, g: Array) -> Array:
        """x[k] = J x[k+1] + g[k] in every segment, x = g at its end, (N, n)."""
        turned = g[::-1]
        later = self._reversed(J, turned)
        return np.asarray((later @ J.T + turned)[::-1])

    def parts(self, x: Array) -> list[Array]:
        """An array of all samples, by segment."""
        return np.split(x, self.bounds[1:-1])


@final
@dataclass(frozen=True, eq=False)
class Innovations:
    """A (n, n), B (n, q), C (m, n), D (m, q), K (n, m), S (m, m)."""

    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    S: Array

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    def parameters(self, feedthrough: bool) -> int:
        """How many numbers a fit determines: all but the n^2 that are coordinates of the state."""
        n, (m, q) = self.n, self.D.shape
        return int(n * (2 * m + q) + m * (m + 1) // 2 + (m * q if feedthrough else 0))


@final
@dataclass(frozen=True, eq=False)
class Independent:
    """A (n, n), B (n, q), C (m, n), D (m, q), Q (n, n), r (m,): variances of the sensors' noises."""

    A: Array
    B: Array
    C: Array
    D: Array
    Q: Array
    r: Array

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    def parameters(self, feedthrough: bool) -> int:
        """How many numbers a fit determines: all but the n^2 that are coordinates of the state."""
        n, (m, q) = self.n, self.D.shape
        return int(n * (m + q) + n * (n + 1) // 2 + m + (m * q if feedthrough else 0))

    def turned(self, T: Array) -> Independent:
        """The same model for the state T^-1 x."""
        back = np.linalg.inv(T)
        return Independent(
            back @ self.A @ T, back @ self.B, self.C @ T, self.D, symmetric(back @ self.Q @ back.T), self.r
        )


@final
@dataclass(frozen=True, eq=False)
class Stationary:
    """The stationary Kalman filter of an independent model: P = cov x[k|k-1], S, gain L, x[k|k] = x[k|k-1] +
    L e.
    """

    P: Array
    S: Array
    L: Array


def symmetric(X: Array) -> Array:
    """The symmetric part, so that rounding cannot grow."""
    return np.asarray((X + X.T) / 2)


def radius(A: Array) -> float:
    """Largest |eigenvalue|."""
    return float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))


def stationary(model: Independent) -> Stationary:
    """Solve the filter's Riccati equation.

    Raises:
        LinAlgError: there is no stationary filter, or none was found.
    """
    P = doubling(model.A, model.C, model.Q, np.diag(model.r))
    if P is None:
        raise np.linalg.LinAlgError("no stationary filter")
    S = symmetric(model.C @ P @ model.C.T + np.diag(model.r))
    L = linalg.cho_solve(linalg.cho_factor(S), model.C @ P).T
    return Stationary(P, S, np.asarray(L))


def innovations_of(model: Independent, steady: Stationary | None = None) -> Innovations:
    """The innovations form with the same law of y."""
    known = stationary(model) if steady is None else steady
    return Innovations(model.A, model.B, model.C, model.D, model.A @ known.L, known.S)


def spread(A: Array, noise: Array) -> Array:
    """The stationary covariance of x+ = A x + noise; a mode at the edge of stability is taken as just
    inside.
    """
    inside = A * min(1.0, EDGE / max(radius(A), 1e-300))
    return long_run(inside, noise)


def long_run(A: Array, noise: Array) -> Array:
    """X = A X A' + noise of a stable A: of few states one linear system, without scipy's many checks of it.

    Raises:
        LinAlgError: A has eigenvalues whose product is one.
    """
    n = len(A)
    if n >= FEW:
        return symmetric(np.asarray(linalg.solve_discrete_lyapunov(A, noise)))
    system = np.eye(n * n) - (A[:, None, :, None] * A[None, :, None, :]).reshape(n * n, n * n)
    *_, X, failed = linalg.lapack.dgesv(system, noise.ravel())
    if failed or not np.all(np.isfinite(X)):
        raise np.linalg.LinAlgError("no stationary covariance")
    return symmetric(X.reshape(n, n))


def whiten(E: Array, S: Array) -> Array:
    """S^-1/2 e for every row, so that its squares add up to the normalised innovation squared (NIS)."""
    return np.asarray(linalg.solve_triangular(np.linalg.cholesky(S), E.T, lower=True).T)


def log_density(E: Array, S: Array) -> Array:
    """Log N(e; 0, S) of every row, nats."""
    _, size = np.linalg.slogdet(2 * np.pi * S)
    return np.asarray(-0.5 * (np.sum(whiten(E, S) ** 2, axis=1) + size))


class Predictor:
    """Predicts segments by an innovations form; the state each starts in is estimated from the segment
    itself.

    Prior of x[0]: what the predicted state's covariance is in the long run, inputs taken as white with
    variance one.
    """

    def __init__(self, model: Innovations) -> None:
        self.model = model
        self.F = model.A - model.K @ model.C
        self._decay = self._powers()
        self._seen = model.C @ self._decay
        self._weighed = linalg.cho_solve(linalg.cho_factor(model.S), np.eye(len(model.S))) @ self._seen
        X = spread(model.A, model.K @ model.S @ model.K.T + model.B @ model.B.T)
        values, V = np.linalg.eigh(X)
        values = np.maximum(values, 1e-6 * max(values[-1], 1e-9))
        self._prior = (V / values) @ V.T

    def _powers(self) -> Array:
        """I, F, F^2, ... as long as they matter, (T, n, n); twice as many with every product."""
        powers, further = np.eye(self.model.n)[None], self.F
        while len(powers) < MEMORY and np.max(np.abs(further)) > 1e-4:
            powers = np.concatenate([powers, powers @ further])
            further = further @ further
        return powers

    def __call__(self, stack: Stack) -> tuple[Array, Array]:
        """Innovations e (N, m) and predicted states x[k|k-1] (N, n) of all samples."""
        model = self.model
        through = stack.y - stack.u @ model.D.T if np.any(model.D) else stack.y
        x = stack.forwards(self.F, stack.u @ model.B.T + through @ model.K.T)
        e = through - x @ model.C.T
        counts = np.minimum(np.diff(stack.bounds), len(self._decay))
        information = {count: self._information(count) for count in set(counts.tolist())}
        for begin, count in zip(stack.bounds[:-1].tolist(), counts.tolist(), strict=True):
            felt = slice(begin, begin + count)
            heard = self._weighed[:count].reshape(-1, model.n).T @ e[felt].ravel()
            moved = self._decay[:count] @ np.linalg.solve(information[count], heard)
            x[felt] += moved
            e[felt] -= moved @ model.C.T
        return e, x

    def _information(self, count: int) -> Array:
        """What so many samples say of the state they start in, and what is known before."""
        n = self.model.n
        heard = self._weighed[:count].reshape(-1, n).T @ self._seen[:count].reshape(-1, n)
        return np.asarray(self._prior + heard)


def innovations(model: Innovations | Independent, record: Record) -> list[Array]:
    """The innovations e of every segment, each (N, m)."""
    predict = Predictor(innovations_of(model) if isinstance(model, Independent) else model)
    stack = Stack(record)
    return stack.parts(predict(stack)[0])
