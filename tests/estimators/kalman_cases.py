"""Random plants and data for the tests of the Kalman filter."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from securestate import Belief, Plant, Sensor

Array = NDArray[np.float64]


def random_plant(seed: int, n: int = 4, m: int = 6, *, radius: float = 0.95, **options: Any) -> Plant:
    """A plant with three sensors, two inputs with feedthrough, and noise correlated between sensors."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    root, noise = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    rows = np.array_split(rng.normal(size=(m, n)), 3)
    settings: dict[str, Any] = {
        "B": rng.normal(size=(n, 2)),
        "D": rng.normal(size=(m, 2)),
        "R": noise @ noise.T + 0.1 * np.eye(m),
    }
    sensors = [Sensor(f"s{i}", C=C) for i, C in enumerate(rows)]
    return Plant(A, 0.1 * root @ root.T, sensors, **(settings | options))


def random_data(plant: Plant, T: int, seed: int, *, missing: float = 0.0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    y, u = 3 * rng.normal(size=(T, plant.m)), rng.normal(size=(T, plant.n_inputs))
    y[rng.random(y.shape) < missing] = np.nan
    return y, u


def some_prior(plant: Plant) -> Belief:
    root = np.random.default_rng(99).normal(size=(plant.n, plant.n))
    return Belief(np.arange(plant.n, dtype=float), root @ root.T + np.eye(plant.n))
