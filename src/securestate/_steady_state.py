"""The steady state of the Kalman filter: the covariance that repeats itself, and the gain that belongs to it.

    S = C P C' + R,   K = P C' S^-1,   P+ = (I - K C) P (I - K C)' + K R K',   P = A P+ A' + Q

P is the stabilising solution: the error dynamics M = (I - K C) A have all eigenvalues inside the unit circle.
It exists if and only if (A, C) is detectable and noise reaches every mode on the unit circle.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate.errors import DesignError
from securestate.plant import Plant
from securestate.resilience.detectability import undetectable_modes, unreachable_noise_modes

Array = NDArray[np.float64]

#: Largest residual of the Riccati equation that counts as solved, relative to the standard deviations.
TOLERANCE = 1e-9

#: A residual that needs no second method.
GOOD = 1e-13

#: Eigenvalues this close to the unit circle count as on it.
EDGE = 1e-9

#: A filter whose error decays at least this fast exists beyond doubt, if it solves the equation.
SAFE = 1 - 1e-5


@final
@dataclass(frozen=True)
class SteadyState:
    """The time-invariant Kalman filter.

    Attributes:
        P_prior: covariance of x[k|k-1], shape (n, n).
        P_posterior: covariance of x[k|k], shape (n, n).
        gain: K with x[k|k] = x[k|k-1] + K innovation, shape (n, m).
        M: A - K C A, error dynamics from x[k-1|k-1] to x[k|k] and closed loop of x[k|k], shape (n, n).
        innovation_cov: S = C P_prior C' + R, shape (m, m).
    """

    P_prior: Array
    P_posterior: Array
    gain: Array
    M: Array
    innovation_cov: Array


def steady_state(plant: Plant) -> SteadyState:
    """Solve the filter's algebraic Riccati equation and check the solution.

    Raises:
        DesignError: the plant varies in time, a mode is not detectable, noise does not reach a mode on the
            unit circle, or the equation is too ill-conditioned to be solved.

    Examples:
        >>> from securestate.plant import Plant, Sensor
        >>> steady = steady_state(Plant([[1.0]], [[2.0]], [Sensor("level", C=[1.0], R=4.0)]))
        >>> print(steady.P_prior, steady.gain)      # P = P - P^2 / (P + 4) + 2
        [[4.]] [[0.5]]
    """
    if plant.time_varying:
        raise DesignError("a time-varying plant has no steady state", "give a prior with a covariance P")
    solutions = []
    for solve in (_solve_doubling, _solve_schur):
        solutions.append(solve(plant))
        steady = None if solutions[-1] is None else _derive(plant, solutions[-1])
        if steady is not None and _residual(plant, steady) <= GOOD and _radius(steady.M) <= SAFE:
            return steady
    return _with_care(plant, solutions)


def _with_care(plant: Plant, solutions: Sequence[Array | None]) -> SteadyState:
    """The best of several solutions that are not accurate beyond doubt; refuses a plant that has none."""
    _refuse_impossible(plant)
    best, error = None, TOLERANCE
    for solution in solutions:
        steady = _finish(plant, solution)
        if steady is not None and _residual(plant, steady) <= error and _radius(steady.M) < 1.0:
            best, error = steady, _residual(plant, steady)
        if best is not None and error <= GOOD:
            return best
    if best is not None:
        return best
    raise DesignError(
        "the Riccati equation of this plant is too ill-conditioned to be solved",
        "rescale the states so that their variances are of similar size",
    )


def _refuse_impossible(plant: Plant) -> None:
    for mode in undetectable_modes(plant):
        raise DesignError(
            f"no sensor sees {mode}, whose error does not decay", "add a sensor that depends on it"
        )
    for mode in unreachable_noise_modes(plant):
        if abs(abs(mode.eigenvalue) - 1.0) <= EDGE:
            raise DesignError(
                f"no process noise reaches {mode} on the unit circle, so the filter's gain falls to zero",
                "give Q a component in that mode",
            )


def _solve_schur(plant: Plant) -> Array | None:
    """P by the ordered Schur form of the symplectic pencil; None if LAPACK cannot order it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            P = linalg.solve_discrete_are(plant.A.T, plant.C.T, plant.Q, plant.R)
    except (linalg.LinAlgError, ValueError):
        return None
    return np.asarray((P + P.T) / 2, dtype=np.float64) if np.all(np.isfinite(P)) else None


def _solve_doubling(plant: Plant) -> Array | None:
    return doubling(plant.A, plant.C, plant.Q, plant.R)


def doubling(A: Array, C: Array, Q: Array, R: Array, steps: int = 60) -> Array | None:
    """P = cov x[k|k-1] by structure-preserving doubling; None if it breaks down.

    Step k holds the Riccati recursion after 2^k samples. A (n, n), C (m, n), Q (n, n), R (m, m).
    """
    A, P, I = A.T, Q, np.eye(len(A))
    with np.errstate(all="ignore"):
        try:
            G = C.T @ linalg.cho_solve(linalg.cho_factor(R), C)
            for _ in range(steps):
                *_, W, singular = linalg.lapack.dgesv(I + G @ P, np.hstack([A, G]))
                if singular:
                    return None
                W_A, W_G = np.hsplit(np.ascontiguousarray(W), 2)
                A, G, new = A @ W_A, _symmetric(G + A @ W_G @ A.T), _symmetric(P + A.T @ P @ W_A)
                change, size = np.max(np.abs(new - P)), np.max(np.abs(new))
                if not np.isfinite(size):
                    return None
                if change <= 1e-15 * size:
                    return new
                P = new
        except (linalg.LinAlgError, ValueError):
            return None
    return None


def _finish(plant: Plant, P: Array | None) -> SteadyState | None:
    """One Newton step, kept if it brings P closer, and everything that follows from P."""
    if P is None:
        return None
    first = _derive(plant, P)
    F, noise = _joseph(plant, first.gain)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            refined = linalg.solve_discrete_lyapunov(plant.A @ F, plant.A @ noise @ plant.A.T + plant.Q)
    except (linalg.LinAlgError, ValueError):
        return first
    second = _derive(plant, _symmetric(np.asarray(refined, dtype=np.float64)))
    return min(first, second, key=lambda steady: _residual(plant, steady))


def _derive(plant: Plant, P: Array) -> SteadyState:
    A, C = plant.A, plant.C
    S = _symmetric(C @ P @ C.T + plant.R)
    try:
        K = linalg.cho_solve(linalg.cho_factor(S), C @ P).T
    except (linalg.LinAlgError, ValueError):
        K = np.full((plant.n, plant.m), np.nan)
    F, noise = _joseph(plant, K)
    return SteadyState(P, _symmetric(F @ P @ F.T + noise), K, A - K @ (C @ A), S)


def _joseph(plant: Plant, K: Array) -> tuple[Array, Array]:
    """F = I - K C and K R K' of the Joseph form P+ = F P F' + K R K'."""
    return np.eye(plant.n) - K @ plant.C, K @ plant.R @ K.T


def _residual(plant: Plant, steady: SteadyState) -> float:
    """Largest change of P over one sample, relative to the magnitudes that enter it; inf if not finite."""
    P = steady.P_prior
    change = np.abs(plant.A @ steady.P_posterior @ plant.A.T + plant.Q - P)
    std = np.sqrt(np.maximum(np.diag(P), 0.0))
    size = np.abs(plant.A) @ std + np.sqrt(np.diag(plant.Q)) + std
    residual = float(np.max(change / np.maximum(np.outer(size, size), np.finfo(np.float64).tiny)))
    return residual if np.isfinite(residual) else np.inf


def _radius(M: Array) -> float:
    """Largest |eigenvalue|; inf if M is not finite."""
    return float(np.max(np.abs(np.linalg.eigvals(M)))) if np.all(np.isfinite(M)) else np.inf


def _symmetric(P: Array) -> Array:
    return np.asarray((P + P.T) / 2, dtype=np.float64)
