"""The test of sensors that may lie against a Kalman filter of those that may not, as in a textbook. Slow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from securestate import Plant

Array = NDArray[np.float64]


@dataclass
class Textbook:
    """Per sample: attack and its std (T, m), squared distance over its quantile (T, N)."""

    attack: Array
    attack_std: Array
    excess: Array


def judge(plant: Plant, y: Array, u: Array, x: Array, P: Array, rate: float) -> Textbook:
    """From the belief x (n,), P on; y (T, m), NaN where missing.

    What a sensor that may lie sent, against its expectation given all that protected ones sent up to then.
    """
    m = plant.m
    strong = plant.protected[plant.channel_sensor]
    attack, std = np.full((len(y), m), np.nan), np.full((len(y), m), np.nan)
    excess = np.full((len(y), plant.n_sensors), np.nan)
    for k, yk in enumerate(y):
        A, C = (M[k] if M.ndim == 3 else M for M in (plant.A, plant.C))
        sent, nu, S = ~np.isnan(yk), yk - C @ x - plant.D @ u[k], C @ P @ C.T + plant.R
        s = np.flatnonzero(sent & strong)
        attack[k, s] = std[k, s] = 0.0
        for i in np.flatnonzero(~plant.protected):
            w = np.flatnonzero(sent & (plant.channel_sensor == i))
            if w.size:
                G = S[np.ix_(w, s)] @ np.linalg.inv(S[np.ix_(s, s)])
                r, V = nu[w] - G @ nu[s], S[np.ix_(w, w)] - G @ S[np.ix_(s, w)]
                attack[k, w], std[k, w] = r, np.sqrt(np.diag(V))
                excess[k, i] = r @ np.linalg.inv(V) @ r / chi2.ppf(1 - rate, w.size)
        K = P @ C[s].T @ np.linalg.inv(S[np.ix_(s, s)])
        F = np.eye(plant.n) - K @ C[s]
        x, P = x + K @ nu[s], F @ P @ F.T + K @ plant.R[np.ix_(s, s)] @ K.T
        x, P = A @ x + plant.B @ u[k], A @ P @ A.T + plant.Q
    return Textbook(attack, std, excess)
