"""The adaptive filter as in a textbook: full covariance matrices, formed and inverted. Slow."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from securestate import Plant

Array = NDArray[np.float64]


@dataclass
class Textbook:
    """Per sample: x (T, n), P (T, n, n), channels (T, m), excess over the quantile (T, N), numbers (T,)."""

    x: Array
    P: Array
    attack: Array
    attack_std: Array
    innovation: Array
    innovation_std: Array
    excess: Array
    log_likelihood: Array
    nis: Array
    eta: Array


def adaptive_joint(
    plant: Plant, y: Array, u: Array, x: Array, P: Array, window: int, gate: float, rate: float
) -> Textbook:
    """Filter y (T, m), NaN where missing, with u (T, p) from the belief x (n,), P (n, n)."""
    past: list[list[float]] = [[] for _ in range(plant.m)]
    rows: list[dict[str, Any]] = []
    cannot_lie = plant.protected[plant.channel_sensor]
    for k, (yk, uk) in enumerate(zip(y, u, strict=True)):
        A, C = at(plant.A, k), at(plant.C, k)
        z, S, sent = yk - C @ x - plant.D @ uk, C @ P @ C.T + plant.R, ~np.isnan(yk)
        p, w = np.flatnonzero(sent & cannot_lie), np.flatnonzero(sent & ~cannot_lie)
        nu, given = conditional(z, S, p, w)
        eta = np.zeros(plant.m)
        for j, channel in enumerate(w):
            past[channel] = [*past[channel], nu[j] ** 2 - given[j, j]][-window:]
            eta[channel] = max(0.0, float(np.mean(past[channel])))
            if nu[j] ** 2 > gate * given[j, j]:
                eta[channel] = max(eta[channel], past[channel][-1])
        row: dict[str, Any] = {"innovation": z, "innovation_std": np.sqrt(np.diag(S))}
        row |= judged(plant, sent, w, nu, given, rate)
        row["eta"] = float((eta / np.diag(plant.R))[w].max(initial=0.0))
        x, P, row["log_likelihood"], row["nis"] = corrected(C, plant.R + np.diag(eta), z, sent, x, P)
        rows.append(row | {"x": x, "P": P})
        x, P = A @ x + plant.B @ uk, A @ P @ A.T + plant.Q
    return Textbook(**{one.name: np.array([row[one.name] for row in rows]) for one in fields(Textbook)})


def conditional(z: Array, S: Array, p: NDArray[np.intp], w: NDArray[np.intp]) -> tuple[Array, Array]:
    """Mean and covariance of z_w about its prediction from z_p."""
    G = S[np.ix_(w, p)] @ np.linalg.inv(S[np.ix_(p, p)])
    return z[w] - G @ z[p], S[np.ix_(w, w)] - G @ S[np.ix_(p, w)]


def judged(
    plant: Plant, sent: NDArray[np.bool_], w: NDArray[np.intp], nu: Array, given: Array, rate: float
) -> dict[str, Array]:
    attack = np.where(sent, 0.0, np.nan)
    std = attack.copy()
    attack[w], std[w] = nu, np.sqrt(np.diag(given))
    excess = np.full(plant.n_sensors, np.nan)
    for sensor in set(plant.channel_sensor[w]):
        own = plant.channel_sensor[w] == sensor
        distance = nu[own] @ np.linalg.inv(given[np.ix_(own, own)]) @ nu[own]
        excess[sensor] = distance / chi2.ppf(1 - rate, own.sum())
    return {"attack": attack, "attack_std": std, "excess": excess}


def corrected(
    C: Array, R: Array, z: Array, sent: NDArray[np.bool_], x: Array, P: Array
) -> tuple[Array, Array, float, float]:
    C, R, z = C[sent], R[np.ix_(sent, sent)], z[sent]
    S = C @ P @ C.T + R
    K = P @ C.T @ np.linalg.inv(S)
    F = np.eye(len(x)) - K @ C
    nis = float(z @ np.linalg.inv(S) @ z)
    log_likelihood = -0.5 * (len(z) * np.log(2 * np.pi) + np.linalg.slogdet(S)[1] + nis)
    return x + K @ z, F @ P @ F.T + K @ R @ K.T, float(log_likelihood), nis


def at(M: Array, k: int) -> Array:
    return M[k] if M.ndim == 3 else M
