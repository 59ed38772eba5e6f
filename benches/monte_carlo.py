"""Simulate and estimate, many runs: the same loop written with filterpy, and a comparison as in a paper."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from filterpy.kalman import KalmanFilter as FilterPy
from numpy.random import SeedSequence, default_rng
from numpy.typing import NDArray

from benches import plants
from benches.timing import Comparison, Contender
from securestate import ChiSquareFilter, InnovationGate, KalmanFilter, Plant, SparseFusion
from securestate.attacks import Bias, Drawn, Freeze, NoiseLinear, RandomNoise, Redrawn
from securestate.simulation import FAMILIES, Simulator, compare
from securestate.simulation.simulate import square_root

Float = NDArray[np.float64]
TOLERANCE = 1e-8
SEED = 7
#: Ten estimators and five adversaries, one of them absent.
ESTIMATORS = {
    "kalman": KalmanFilter,
    **{f"sparse {p}": partial(SparseFusion, kalman_probability=p) for p in (0.5, 0.9, 0.99)},
    **{f"gate {rate}": partial(InnovationGate, false_alarm_rate=rate) for rate in (0.01, 0.001)},
    **{
        f"chi-square {scope}, {on_alarm}": partial(ChiSquareFilter, scope=scope, on_alarm=on_alarm)
        for scope, on_alarm in (
            ("sensor", "drop"), ("sensor", "hold"), ("central", "predict"), ("central", "drop-worst")
        )
    },
}  # fmt: skip
ATTACKS = {
    "none": None,
    "bias": Bias(5.0, on=Drawn(3)),
    "noise": RandomNoise(10.0, on=Drawn(3)),
    "freeze": Freeze(on=Drawn(3), start=1),
    "changing": NoiseLinear(on=Redrawn((1, 3))),
}


def loops(quick: bool) -> Iterator[Comparison]:
    """One plant, one filter."""
    runs, steps = (20, 50) if quick else (100, 100)
    for n, m in ((4, 5),) if quick else ((4, 5), (4, 15), (10, 20)):
        plant = plants.plant(n, m)
        size = f"n={n} m={m}, {runs} runs x {steps}"
        ours, theirs = _ours(plant, runs, steps), _filterpy(plant, runs, steps)
        yield Comparison("simulate and filter", size, ours, theirs, TOLERANCE)


def papers(quick: bool) -> Iterator[Comparison]:
    """Ten estimators, five adversaries; per sample of an estimator, all scores included."""
    runs, steps = (10, 50) if quick else (500, 100)
    plant = FAMILIES["partial-planar"](default_rng(SEED))
    size = f"n={plant.n} m={plant.m}, 5 x 10 x {runs} runs x {steps}"

    def work(_: None) -> Float:
        result = compare(plant, ESTIMATORS, ATTACKS, runs=runs, steps=steps, seed=SEED, workers=1)
        return result.table["mse"].to_numpy()

    count = len(ESTIMATORS) * len(ATTACKS) * runs * steps
    yield Comparison("comparison as in a paper", size, Contender("ours", work, count), None)


def _ours(plant: Plant, runs: int, steps: int) -> Contender:
    simulator, estimator = Simulator(plant, steps), KalmanFilter(plant)

    def work(_: None) -> Float:
        trajectory = simulator.run(seed=SEED, runs=runs)
        return trajectory.confront(estimator, covariance=False)[0].x.ravel()

    return Contender("ours", work, runs * steps)


def _filterpy(plant: Plant, runs: int, steps: int) -> Contender:
    """The same draws, one run after the other, one sample after the other."""
    steady = KalmanFilter(plant).steady
    assert steady is not None
    root_P, root_Q, root_R = (square_root(M) for M in (steady.P_prior, plant.Q, plant.R))

    def one(run: int) -> Iterator[Float]:
        rng = default_rng(SeedSequence(SEED, spawn_key=(run, 0, 0)))
        kalman = FilterPy(dim_x=plant.n, dim_z=plant.m)
        kalman.F, kalman.H, kalman.Q, kalman.R = plant.A, plant.C, plant.Q, plant.R
        kalman.P = steady.P_prior.copy()
        x = np.zeros(plant.n)
        for k in range(steps):
            z = rng.standard_normal(plant.n + plant.m)
            own = z[: plant.n]
            x = plant.A @ x + root_Q @ own if k else root_P @ own
            if k:
                kalman.predict()
            kalman.update(plant.C @ x + root_R @ z[plant.n :])
            yield kalman.x.ravel().copy()

    def work(_: None) -> Float:
        return np.concatenate([x for run in range(runs) for x in one(run)])

    return Contender("filterpy", work, runs * steps)


CASES: dict[str, Callable[[bool], Iterator[Comparison]]] = {"loops": loops, "papers": papers}
