"""Plants and measurements of any size, the same on every machine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from securestate import Plant, Sensor

Float = NDArray[np.float64]


def plant(n: int, m: int) -> Plant:
    """A random plant with a mode on the unit circle, one sensor per channel, independent noise."""
    rng = np.random.default_rng([n, m])
    A = rng.standard_normal((n, n))
    A /= np.abs(np.linalg.eigvals(A)).max()
    G = rng.standard_normal((n, n)) / np.sqrt(n)
    Q = 0.1 * (G @ G.T + np.eye(n))
    R = rng.uniform(0.5, 2.0, m)
    C = rng.standard_normal((m, n))
    return Plant(A, Q, [Sensor(f"s{i}", C=C[i], R=R[i]) for i in range(m)])


def measurements(plant: Plant, steps: int, runs: int | None = None) -> Float:
    """Simulated measurements, (steps, m) or (runs, steps, m)."""
    rng = np.random.default_rng([plant.n, plant.m, steps])
    lead = () if runs is None else (runs,)
    root_Q, root_R = np.linalg.cholesky(plant.Q), np.linalg.cholesky(plant.R)
    x = np.zeros((*lead, plant.n))
    rows = []
    for _ in range(steps):
        x = x @ plant.A.T + rng.standard_normal(x.shape) @ root_Q.T
        rows.append(x @ plant.C.T + rng.standard_normal((*lead, plant.m)) @ root_R.T)
    return np.stack(rows, axis=-2)


def with_gaps(y: Float, share: float) -> Float:
    """The same with a share of the numbers missing."""
    gaps = np.random.default_rng(len(y)).random(y.shape) < share
    return np.where(gaps, np.nan, y)


def attacked(y: Float, liars: int, size: float) -> Float:
    """The same with the first sensors lying: a constant and noise that changes from sample to sample."""
    lies = np.zeros_like(y)
    rng = np.random.default_rng(liars)
    lies[:, :liars] = size * (1.0 + 0.3 * rng.standard_normal((len(y), liars)))
    return y + lies
