"""The Kalman filter as in a textbook: one correction per sample, covariance in Joseph form. Slow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from securestate import Plant

Array = NDArray[np.float64]


@dataclass
class Textbook:
    """Per sample: x (T, n), P (T, n, n), innovation and its std (T, m), log_likelihood and nis (T,)."""

    x: Array
    P: Array
    innovation: Array
    innovation_std: Array
    log_likelihood: Array
    nis: Array


def textbook_filter(plant: Plant, y: Array, u: Array, x: Array, P: Array) -> Textbook:
    """Filter y (T, m), NaN where missing, with u (T, p) from the belief x (n,), P (n, n)."""
    rows = []
    for k, (yk, uk) in enumerate(zip(y, u, strict=True)):
        A = plant.A[k] if plant.A.ndim == 3 else plant.A
        C = plant.C[k] if plant.C.ndim == 3 else plant.C
        innovation = yk - C @ x - plant.D @ uk
        std = np.sqrt(np.diag(C @ P @ C.T + plant.R))
        x, P, log_likelihood, nis = _correct(C, plant.R, innovation, x, P)
        rows.append((x, P, innovation, std, log_likelihood, nis))
        x, P = A @ x + plant.B @ uk, A @ P @ A.T + plant.Q
    return Textbook(*(np.array(column) for column in zip(*rows, strict=True)))


def _correct(C: Array, R: Array, innovation: Array, x: Array, P: Array) -> tuple[Array, Array, float, float]:
    arrived = ~np.isnan(innovation)
    C, R, z = C[arrived], R[np.ix_(arrived, arrived)], innovation[arrived]
    if not z.size:
        return x, P, 0.0, 0.0
    S = C @ P @ C.T + R
    K = np.linalg.solve(S, C @ P).T
    F = np.eye(len(x)) - K @ C
    nis = float(z @ np.linalg.solve(S, z))
    log_likelihood = -0.5 * (len(z) * np.log(2 * np.pi) + np.linalg.slogdet(S)[1] + nis)
    return x + K @ z, F @ P @ F.T + K @ R @ K.T, float(log_likelihood), nis
