"""Microseconds per step of SecureFilter from Python, beside InnovationMixture, in quiet and under attack."""

from __future__ import annotations

import time
import warnings

import numpy as np
from numpy.typing import NDArray

from benches import machine
from benches.table import markdown
from securestate import Estimator, InnovationMixture, InsecureWarning, Plant, SecureFilter, Sensor

Float = NDArray[np.float64]

#: States, sensors, steps.
SIZES = ((1, 15, 4000), (4, 5, 4000), (50, 150, 150), (200, 200, 30))

#: Share of the sensors that are attacked, and how often the fastest of the repetitions is looked for.
SHARE, REPEAT = 0.3, 3


def plant(states: int, sensors: int, rng: np.random.Generator) -> Plant:
    """A stable plant whose sensors each see a random combination of all states."""
    A = rng.standard_normal((states, states))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    rows = rng.standard_normal((sensors, states))
    each = [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(rows)]
    return Plant(A, 0.5 * np.eye(states), each)


def records(of: Plant, steps: int, rng: np.random.Generator) -> dict[str, Float]:
    """Readings (steps, m): of nobody attacked, of a fixed set, of one that changes at every sample."""
    x, y = np.zeros(of.n), np.empty((steps, of.m))
    for k in range(steps):
        x = of.A @ x + np.sqrt(0.5) * rng.standard_normal(of.n)
        y[k] = of.C @ x + rng.standard_normal(of.m)
    fixed = np.zeros(y.shape, dtype=bool)
    fixed[:, : round(SHARE * of.m)] = True
    redrawn = rng.random(y.shape) < SHARE
    noise = rng.standard_normal(y.shape)
    return {"nobody": y, "fixed set": y + 20 * fixed * noise, "redrawn": y + 5 * redrawn * noise}


def seconds(estimator: Estimator, y: Float) -> float:
    """Of one step, the fastest of some repetitions of a live filter."""
    best = np.inf
    for _ in range(REPEAT):
        live = estimator.start()
        begin = time.perf_counter()
        for sample in y:
            live.step(sample)
        best = min(best, (time.perf_counter() - begin) / len(y))
    return float(best)


def main() -> None:
    for line in machine.describe():
        print(line)
    rows = []
    for states, sensors, steps in SIZES:
        rng = np.random.default_rng(0)
        of = plant(states, sensors, rng)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InsecureWarning)
            both = [SecureFilter(of), InnovationMixture(of)]
        for attack, y in records(of, steps, rng).items():
            cells = [f"{1e6 * seconds(estimator, y):.3g}" for estimator in both]
            rows.append([str(states), str(sensors), attack, *cells])
    columns = ["states", "sensors", "attacked", "SecureFilter, µs", "InnovationMixture, µs"]
    print("\n".join(markdown(columns, rows)))


if __name__ == "__main__":
    main()
