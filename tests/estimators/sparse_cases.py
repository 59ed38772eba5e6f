"""Plants and records for the tests of sparse fusion."""

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from securestate import Plant, Sensor

Array = NDArray[np.float64]

LIU_C = np.array([[1, 0, 0], [1, 1, -1], [1, 2, 1], [1, -1, -0.5], [-0.5, 1, 1]])
#: u = −L x keeps Liu's plant, whose eigenvalues are 1, 1 and −2, bounded.
LIU_L = np.diag([0.5, 0.5, -2.0])


def liu(inputs: bool = True) -> Plant:
    """Section VI of Liu, Mo, Garone 2020; with B = I so that a known input can keep it bounded."""
    sensors = [Sensor(f"s{i + 1}", C=row, R=1.0) for i, row in enumerate(LIU_C)]
    return Plant(np.diag([1.0, 1.0, -2.0]), np.eye(3), sensors, B=np.eye(3) if inputs else None)


def liu_record(steps: int, seed: int, attack: Array | float = 0.0) -> tuple[Array, Array, Array]:
    """States, measurements and inputs of Liu's plant in closed loop."""
    rng = np.random.default_rng(seed)
    w, v = rng.standard_normal((steps, 3)), rng.standard_normal((steps, 5))
    x = np.empty((steps, 3))
    for i, value in enumerate((np.array([1.0, 1.0, -2.0]) - np.diag(LIU_L)).tolist()):
        drive = w[:-1, i].tolist()
        x[:, i] = list(accumulate(drive, lambda x, w, value=value: value * x + w, initial=0.0))
    return x, x @ LIU_C.T + v + attack, -x @ LIU_L.T


def stable_plant(n: int, m: int, seed: int, **changes: object) -> Plant:
    """A random stable plant with one slow mode and a scalar sensor per channel."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    sensors = [Sensor(f"s{i}", C=row, R=r) for i, (row, r) in enumerate(_rows(rng, n, m))]
    return Plant(A, 0.3 * np.eye(n), sensors, **changes)


def record(plant: Plant, steps: int, seed: int) -> tuple[Array, Array]:
    """States and measurements of a plant without inputs, in file units."""
    rng = np.random.default_rng(seed)
    w = rng.multivariate_normal(np.zeros(plant.n), plant.Q, steps, method="cholesky")
    v = rng.multivariate_normal(np.zeros(plant.m), plant.R, steps, method="cholesky")
    x = np.zeros((steps, plant.n))
    for k in range(steps - 1):
        x[k + 1] = plant.A @ x[k] + w[k]
    return x, plant.denormalise(x @ plant.C.T + v)


def _rows(rng: np.random.Generator, n: int, m: int) -> list[tuple[Array, float]]:
    return list(zip(rng.standard_normal((m, n)), rng.uniform(0.5, 2.0, m), strict=True))
