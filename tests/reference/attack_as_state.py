"""Injections as states of a Kalman filter, and Zhang's drift of them, with full matrices. Slow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from securestate import Plant

Array = NDArray[np.float64]


@dataclass
class System:
    """The augmented system in normalised units; A and C (T, ...)."""

    A: Array
    B: Array
    C: Array
    D: Array
    Q: Array
    R: Array
    F: Array
    weak: Array


@dataclass
class Textbook:
    """Per sample: X (T, N), its covariance, the innovation (T, m) and its std, log_likelihood and nis."""

    X: Array
    P: Array
    innovation: Array
    innovation_std: Array
    log_likelihood: Array
    nis: Array
    S: Array | None = None


def augmented(plant: Plant, noise: Array, T: int) -> System:
    """The system with one more state per weak channel; `noise` (w,) in sensor units squared."""
    weak = np.array([i for i in range(plant.m) if not plant.protected[plant.channel_sensor[i]]])
    w, n = len(weak), plant.n
    A, C = (np.broadcast_to(M, (T, *M.shape[-2:])) for M in (plant.A, plant.C))
    return System(
        A=np.array([block_diag(a, np.eye(w)) for a in A]),
        B=np.vstack([plant.B, np.zeros((w, plant.n_inputs))]),
        C=np.array([np.hstack([c, np.eye(plant.m)[:, weak]]) for c in C]),
        D=plant.D,
        Q=block_diag(plant.Q, np.diag(noise / plant.scale[weak] ** 2)),
        R=plant.R,
        F=np.vstack([np.zeros((n, w)), np.eye(w)]),
        weak=weak,
    )


def kalman(s: System, y: Array, u: Array, X: Array, P: Array) -> Textbook:
    """The Kalman filter, phi white."""
    return zhang(s, y, u, X, P, drift=np.zeros((len(s.weak), len(s.weak))), forgetting=1.0)


def zhang(s: System, y: Array, u: Array, X: Array, P: Array, *, drift: Array, forgetting: float) -> Textbook:
    """Zhang 2018, (5a)-(5l), from X[0|-1] and P[0|-1]; `drift` is S before the first sample."""
    phi, S, Upsilon, rows = np.zeros(len(s.weak)), drift, s.F.copy(), []
    for k, yk in enumerate(y):
        arrived = ~np.isnan(yk)
        C, R = s.C[k][arrived], s.R[np.ix_(arrived, arrived)]
        keep = np.diag(np.where(arrived[s.weak], forgetting**-0.5, 1.0))
        wide = keep @ S @ keep
        innovation = yk - s.C[k] @ X - s.D @ u[k]
        Omega = s.C[k] @ Upsilon
        std = np.sqrt(np.diag(s.C[k] @ P @ s.C[k].T + s.R + Omega @ wide @ Omega.T))
        Omega, e = Omega[arrived], innovation[arrived]
        Sigma = C @ P @ C.T + R
        total = Sigma + Omega @ wide @ Omega.T
        K = np.linalg.solve(Sigma, C @ P).T
        J = np.eye(len(X)) - K @ C
        P = J @ P @ J.T + K @ R @ K.T
        Upsilon = J @ Upsilon
        if arrived.all():
            Lambda = np.linalg.inv(forgetting * Sigma + Omega @ S @ Omega.T)
            Gamma = S @ Omega.T @ Lambda
            S = (S - S @ Omega.T @ Lambda @ Omega @ S) / forgetting
        else:
            Gamma = np.linalg.solve(total, Omega @ wide).T
            S = wide - Gamma @ Omega @ wide
        before, phi = phi, phi + Gamma @ e
        X = X + K @ e + Upsilon @ (phi - before)
        nis = float(e @ np.linalg.solve(total, e))
        likelihood = -0.5 * (len(e) * np.log(2 * np.pi) + np.linalg.slogdet(total)[1] + nis)
        rows.append((X, P + Upsilon @ S @ Upsilon.T, innovation, std, likelihood, nis, S))
        X, P = s.A[k] @ X + s.B @ u[k] + s.F @ phi, s.A[k] @ P @ s.A[k].T + s.Q
        Upsilon = s.A[k] @ Upsilon + s.F
    return Textbook(*(np.array(column) for column in zip(*rows, strict=True)))
