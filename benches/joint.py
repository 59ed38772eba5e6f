"""JointFusion against our Kalman filter and NumPy with stored gains; its cost by the number of sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benches import plants
from benches.timing import Comparison, Contender
from securestate import Belief, Estimator, JointFusion, KalmanFilter, Plant, Sensor

Float = NDArray[np.float64]
TOLERANCE = 1e-8
FOUR_BUS = Path(__file__).parents[1] / "examples" / "four-bus" / "plant.toml"
#: States and protected sensors of the large plants, and how many sensors may lie.
STATES, PROTECTED, WEAK = 20, 10, (5, 10, 20, 50)


def steps(quick: bool) -> Iterator[Comparison]:
    """One call per sample of the four-bus grid, gains settled."""
    plant = Plant.load(FOUR_BUS)
    y = plants.measurements(plant, 50 if quick else 300)
    ours = _live(JointFusion(plant), y)
    yield Comparison("joint step", "n=4 m=5", ours, _stored(plant, y), TOLERANCE)
    kalman = _live(KalmanFilter(plant), y)
    yield Comparison("joint step", "n=4 m=5", ours, kalman, target=0.5, alike=False)


def sizes(quick: bool) -> Iterator[Comparison]:
    """Steps of many sensors: with settled gains, and while a channel is missing."""
    for weak in WEAK[:1] if quick else WEAK:
        plant = large(weak)
        estimator, y = JointFusion(plant), plants.measurements(plant, 20)
        size = f"n={STATES} r={weak}, {PROTECTED} protected"
        yield Comparison("joint step", size, _live(estimator, y), None)
        gaps = y[:3].copy()
        gaps[:, 0] = np.nan
        yield Comparison("joint step, recursion", size, _live(estimator, gaps), None)


def large(weak: int) -> Plant:
    """A random plant of 20 states, every sensor seeing all of them."""
    rng = np.random.default_rng(weak)
    A = rng.standard_normal((STATES, STATES))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    sensors = [
        Sensor(f"s{i}", C=rng.standard_normal(STATES), R=0.1, protected=i >= weak)
        for i in range(weak + PROTECTED)
    ]
    return Plant(A, np.eye(STATES), sensors)


def _live(estimator: Estimator, y: Float) -> Contender:
    rows = list(y)

    def work(live: Any) -> Float:
        for row in rows:
            estimate = live.step(row)
        return np.asarray(estimate.x)[np.newaxis]

    return Contender(f"our {estimator.name}", work, len(rows), estimator.start)


def _stored(plant: Plant, y: Float) -> Contender:
    """(6) to (8) with the settled gains, as one writes them in NumPy."""
    estimator = JointFusion(plant)
    assert estimator.beside is not None and estimator.beside.steady is not None
    start = Belief(np.zeros(plant.n), estimator.beside.steady.P_prior)
    moments, n = estimator.moments(1000, start), plant.n
    K, Gamma, G = [k[-1] for k in moments.K], [g[-1] for g in moments.Gamma], moments.G[-1]
    channels = [[*local.weak_channels, *local.protected_channels] for local in estimator.locals]
    C = [np.hstack([plant.C[rows], np.eye(len(rows), 1)]) for rows in channels]
    A = np.block([[plant.A, np.zeros((n, 1))], [np.zeros((1, n)), np.eye(1)]])
    F = np.eye(n + 1)[:, n:]

    def work(_: None) -> Float:
        X = [np.zeros(n + 1) for _ in K]
        phi = [np.zeros(1) for _ in K]
        for row in y:
            for i, gain in enumerate(K):
                surprise = row[channels[i]] - C[i] @ X[i]
                X[i] = X[i] + gain @ surprise
                phi[i] = phi[i] + Gamma[i] @ surprise
            x = G @ np.concatenate([each[:n] for each in X])
            X = [A @ each + F @ step for each, step in zip(X, phi, strict=True)]
        return x[np.newaxis]

    return Contender("NumPy, stored gains", work, len(y))


CASES: dict[str, Callable[[bool], Iterator[Comparison]]] = {"joint-step": steps, "joint-sizes": sizes}
