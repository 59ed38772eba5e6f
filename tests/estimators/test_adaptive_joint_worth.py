"""What the adaptive filter is worth on the plant of chen2022, beside ignoring the weak sensors."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from securestate import AdaptiveJointFilter, Belief, KalmanFilter, Plant
from tests.estimators.kalman_cases import Array

FOUR_BUS = Plant.load(Path(__file__).parents[2] / "examples/four-bus/plant.toml")


def four_bus_runs(runs: int, T: int, seed: int) -> tuple[Array, Array]:
    """States and honest readings of the four-bus plant: x ~ N(0, I) one sample before the first."""
    plant, rng = FOUR_BUS, np.random.default_rng(seed)
    before, x = rng.normal(size=(runs, 4)), np.empty((runs, T, 4))
    for k in range(T):
        before = before @ plant.A.T + rng.normal(size=(runs, 4)) * np.sqrt(np.diag(plant.Q))
        x[:, k] = before
    return x, x @ plant.C.T + rng.normal(size=(runs, T, 5)) * np.sqrt(np.diag(plant.R))


def squared_error(
    estimator: AdaptiveJointFilter | KalmanFilter, x: Array, y: Array, score_from: int = 0
) -> float:
    """Mean over runs and samples, from the start of the paper: x = 0 with covariance I one sample earlier."""
    prior = Belief(np.zeros(4), FOUR_BUS.A @ FOUR_BUS.A.T + FOUR_BUS.Q)
    error = (estimator.run(y, prior=prior, covariance=False).x - x)[:, score_from:]
    return float(np.sum(error**2, axis=-1).mean())


def test_the_error_in_the_scenario_of_chen_2022_is_a_fifth_below_that_of_the_protected_sensors_alone() -> (
    None
):
    x, y = four_bus_runs(500, 100, 20221214)
    y[..., 0] += np.sqrt(5) * np.random.default_rng(1).normal(size=(500, 100))
    y[:, 49, 1] += 3
    mine = squared_error(AdaptiveJointFilter(FOUR_BUS), x, y)
    guarded_only = squared_error(KalmanFilter(FOUR_BUS.select([2, 3, 4])), x, y[..., 2:])
    assert mine <= 0.335
    assert mine <= 0.81 * guarded_only
    assert 0.40 < guarded_only < 0.43


@cache
def lies(T: int, runs: int) -> dict[str, Array]:
    """Signals of size 1 from sample 20 on, (runs, T)."""
    k, rng = np.arange(T), np.random.default_rng(5)
    on = k >= 20
    signals = {
        "none": np.zeros(T),
        "impulse": 1.0 * (k % 25 == 24),
        "constant": 1.0 * on,
        "ramp": np.clip((k - 20) / 50, 0, 1),
        "sine": np.sin(0.3 * k) * on,
        "burst": 1.0 * (on & (k // 15 % 2 == 0)),
    }
    return {name: np.tile(signal, (runs, 1)) for name, signal in signals.items()} | {
        "white": rng.normal(size=(runs, T)) * on
    }


@cache
def honest_four_bus() -> tuple[Array, Array, float]:
    """Runs, and the error of the protected sensors alone."""
    x, y = four_bus_runs(400, 130, 7)
    return x, y, squared_error(KalmanFilter(FOUR_BUS.select([2, 3, 4])), x, y[..., 2:], 20)


#: The settings, who lies, and the largest error over that of the protected sensors alone. Two sensors that
#: tell the same lie are the worst case: a constant of three times their noise costs 7 per cent.
WORST: dict[str, tuple[dict[str, Any], list[int], float]] = {
    "weak 1 lies": ({}, [0], 0.8),
    "weak 2 lies": ({}, [1], 0.88),
    "both lie": ({}, [0, 1], 1.08),
    "both lie, short window without a gate": ({"window": 10, "gate": math.inf}, [0, 1], 1.04),
}


@pytest.mark.parametrize("lie", sorted(lies(1, 1)))
@pytest.mark.parametrize("case", WORST)
def test_weak_sensors_help_or_hardly_harm_whatever_they_send(case: str, lie: str) -> None:
    (settings, liars, worst), (x, y, guarded_only) = WORST[case], honest_four_bus()
    estimator = AdaptiveJointFilter(FOUR_BUS, **settings)
    for size in [0.0] if lie == "none" else [1.0, 1.5, 3.0, 10.0]:
        attacked = y.copy()
        attacked[..., liars] += size * lies(130, 400)[lie][..., np.newaxis]
        error = squared_error(estimator, x, attacked, 20)
        assert error < (0.66 if lie == "none" else worst) * guarded_only, size
