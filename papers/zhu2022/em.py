"""The expectation maximisation of Section 3.1 in plain lines, for many sets of scalar estimates at once.

`MixtureFusion` does the same in its kernel and keeps the outcome only; here every likelihood on the way and
Sigma_2 can be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from papers._statistics import Float
from securestate import Plant

TOLERANCE, FLOOR = 1e-6, 1e-9


@dataclass(frozen=True)
class Local:
    """The local filters (8), (10) of a plant with one state, (N,) each.

    Attributes:
        A, C: of the plant. gain: K_i. P: Pbar_i.
    """

    A: float
    C: Float
    gain: Float
    P: Float

    @staticmethod
    def of(plant: Plant) -> Local:
        """The steady state: C² p² + (R (1 − A²) − Q C²) p = Q R for p, the variance before the reading."""
        A, Q, C, R = plant.A[0, 0], plant.Q[0, 0], plant.C[:, 0], np.diag(plant.R)
        b = R * (1 - A**2) - Q * C**2
        p = (np.sqrt(b**2 + 4 * C**2 * Q * R) - b) / (2 * C**2)
        gain = p * C / (C**2 * p + R)
        return Local(float(A), C, gain, (1 - gain * C) * p)

    def predict(self, y: Float) -> Float:
        """x_i^- of every sample, (T, N), of filters that hear the readings y (T, N) one step later."""
        before = np.zeros_like(y)
        for k in range(1, len(y)):
            before[k] = self.A * self.update(before[k - 1], y[k - 1])
        return before

    def update(self, before: Float, y: Float) -> Float:
        """x_i from x_i^- and y_i."""
        return before + self.gain * (y - self.C * before)


@dataclass(frozen=True)
class Fit:
    """K fitted mixtures.

    Attributes:
        belief: gamma^(1), (K, N). variance: Sigma_2, (K,).
        likelihood: (14) at every iteration, (iterations, K); it stands still once a set has converged.
    """

    belief: Float
    variance: Float
    likelihood: Float

    @property
    def attacked(self) -> Float:
        """Mean belief in an attack (20), (K,)."""
        return 1 - self.belief.mean(axis=1)

    @property
    def falls(self) -> Float:
        """Whether the likelihood falls on the way, (K,)."""
        return (np.diff(self.likelihood, axis=0) < -1e-9).any(axis=0).astype(np.float64)


def fit(X: Float, P: Float, init: str, cap: int, *, precise: bool = False) -> Fit:
    """Iterate (15)-(19) on local estimates X (K, N) with variances P (N,); `precise` mends (18)."""
    mean, spread = X.mean(axis=1, keepdims=True), X.std(axis=1, keepdims=True)
    start = {"split": mean - spread, "median": np.median(X, axis=1, keepdims=True), "mean": mean}
    mu1, mu2 = start[init], mean + spread if init == "split" else mean
    variance, share = spread**2, np.full_like(mean, 0.5)
    belief, likelihood = np.ones_like(X), np.empty((0, len(X)))
    busy, last = np.ones(len(X), dtype=bool), np.full(len(X), -np.inf)
    for _ in range(cap):
        one = np.log1p(-share) + _log_normal(X - mu1, P)
        other = np.log(share) + _log_normal(X - mu2, variance + FLOOR * np.maximum(1, variance))
        total = np.logaddexp(one, other)
        belief = np.where(busy[:, np.newaxis], np.exp(one - total), belief)  # (15)
        now = np.where(busy, total.sum(axis=1), last)
        likelihood = np.vstack([likelihood, now])
        busy &= np.abs(now - last) >= TOLERANCE * (1 + np.abs(now))
        last = now
        if not busy.any():
            break
        weight = 1 / P if precise else np.ones_like(P)
        new = (
            _average(belief * weight, X),  # (18)
            _average(1 - belief, X),
            _average(1 - belief, (X - _average(1 - belief, X)) ** 2),  # (19)
            np.clip((1 - belief).mean(axis=1, keepdims=True), 1e-300, 1 - 1e-12),  # (16), (17)
        )
        mu1, mu2, variance, share = (
            np.where(busy[:, np.newaxis], after, before)
            for after, before in zip(new, (mu1, mu2, variance, share), strict=True)
        )
    return Fit(belief, variance[:, 0], likelihood)


def _log_normal(distance: Float, variance: Float) -> Float:
    return -0.5 * (np.log(2 * np.pi * variance) + distance**2 / variance)


def _average(weight: Float, values: Float) -> Float:
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    return np.asarray((weight * values).sum(axis=1, keepdims=True) / total)
