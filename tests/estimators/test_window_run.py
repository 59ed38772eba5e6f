"""Runs that begin with a cold start, of every method, one by one and in batches."""

import warnings
from typing import Any

import numpy as np
import pytest

from securestate import (
    DesignError,
    Estimator,
    InputError,
    JointFusion,
    KalmanFilter,
    OracleFilter,
    Plant,
    Run,
    SecurestateWarning,
    Sensor,
    SparseFusion,
    Status,
    cold_start,
)
from securestate.estimators import METHODS
from tests.estimators.kalman_cases import Array
from tests.estimators.run_arrays import RUN_ARRAYS

T = 40


def plant_of(*, varying: bool = False) -> Plant:
    A = np.array([[0.95, 0.1], [0.0, 0.9]])
    C = [[1.0, 0.0], [1.0, 0.2], [0.5, 1.0], [0.0, 1.0], [1.0, 1.0]]
    sensors = [
        Sensor(f"s{i}", C=row, R=0.1, protected=i in (0, 3), offset=5.0 * i, scale=1.0 + i)
        for i, row in enumerate(C)
    ]
    if varying:
        A = A * (1 - 0.01 * np.arange(T))[:, None, None]
    return Plant(A, 0.1 * np.eye(2), sensors, B=[[1.0], [0.5]])


def records(plant: Plant, runs: int) -> tuple[Array, Array]:
    """Readings (runs, T, m) from far-off starts, s1 adding 30 of its units, and inputs (T, p)."""
    rng = np.random.default_rng(3)
    u, y = rng.normal(size=(T, 1)), np.empty((runs, T, plant.m))
    for run in range(runs):
        x = [50 * rng.normal(size=2)]
        for k in range(T - 1):
            x.append(plant.successor(x[-1][None], u[k : k + 1], k)[0] + np.sqrt(0.1) * rng.normal(size=2))
        y[run] = plant.reading(np.array(x), u)
    y += plant.scale * np.sqrt(0.1) * rng.normal(size=y.shape)
    y[..., 1] += 30.0 * plant.scale[1]
    return y, u


def assert_same(one: Run, other: Run) -> None:
    for name in RUN_ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name, values in one.diagnostics.items():
        np.testing.assert_array_equal(values, other.diagnostics[name])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("varying", [False, True])
def test_every_method_goes_on_from_the_belief(method: str, varying: bool) -> None:
    plant = plant_of(varying=varying)
    try:
        estimator = METHODS[method].design(plant)
    except DesignError:
        assert varying
        return
    y, u = records(plant, 3)
    batch = estimator.run(y, u, prior="window")
    assert batch.x.shape == (3, T, 2) and (batch.status[:, 0] == Status.COLD_START).all()
    for i in range(3):
        single = estimator.run(y[i], u, prior="window")
        first = cold_start(plant, y[i], u)
        tau = first.samples
        np.testing.assert_array_equal(single.x[:tau], first.x)
        assert single.P is not None
        np.testing.assert_array_equal(single.P[:tau], first.P)
        np.testing.assert_array_equal(single.suspected[:tau], first.suspected)
        assert np.isnan(single.innovation[:tau]).all() and not np.isnan(single.innovation[tau:]).any()
        assert all(np.isnan(values[:tau]).all() for values in single.diagnostics.values())
        for name in RUN_ARRAYS:
            np.testing.assert_array_equal(getattr(batch, name)[i], getattr(single, name))
        late = later(estimator, tau).run(y[i, tau:], u[tau:], belief(estimator, first))
        for name in RUN_ARRAYS:
            np.testing.assert_array_equal(getattr(single, name)[tau:], getattr(late, name))


def later(estimator: Estimator, first: int) -> Estimator:
    """The same method for a plant made anew whose first sample is sample `first`."""
    plant = estimator.plant
    if not plant.time_varying:
        return estimator
    cut = Plant(
        plant.A[first:], plant.Q, plant.sensors, B=plant.B, input_names=plant.input_names,
    )  # fmt: skip
    return next(method.design(cut) for method in METHODS.values() if method.design is type(estimator))


def belief(estimator: Estimator, first: Any) -> Any:
    return first.belief if estimator.takes_covariance else type(first.belief)(first.belief.x)


def test_a_start_far_away_costs_a_robust_method_nothing() -> None:
    plant = plant_of()
    y, u = records(plant, 1)
    blind, cold = SparseFusion(plant).run(y[0], u), SparseFusion(plant).run(y[0], u, prior="window")
    assert blind.suspected[0, [0, 2, 3, 4]].any() and not cold.suspected[:, [0, 2, 3, 4]].any()
    assert cold.suspected[:, 1].all()


def test_a_variance_that_varies_is_counted_from_the_window_on() -> None:
    plant = plant_of()
    y, u = records(plant, 1)
    eta = np.geomspace(1.0, 1e4, T)[:, None] * np.ones(3)
    tau = cold_start(plant, y[0], u).samples
    run = JointFusion(plant, eta=eta).run(y[0], u, prior="window")
    late = JointFusion(plant, eta=eta[tau:]).run(y[0, tau:], u[tau:], cold_start(plant, y[0], u).belief)
    np.testing.assert_array_equal(run.x[tau:], late.x)


def test_a_record_no_longer_than_the_window_is_the_window() -> None:
    plant = plant_of()
    y, u = records(plant, 1)
    run = KalmanFilter(plant).run(y[0, :4], u[:4], prior="window", covariance=False)
    assert run.status.tolist() == [Status.COLD_START] * 4 and run.P is None
    np.testing.assert_array_equal(run.x, cold_start(plant, y[0, :4], u[:4]).x)


def test_a_start_that_is_not_certified_is_said_and_marked() -> None:
    plant = plant_of()
    y, u = records(plant, 3)
    y[1] = np.nan
    with pytest.warns(
        SecurestateWarning, match=r"cold start of 1 of 3 runs is not certified: the readings that"
    ):
        run = KalmanFilter(plant).run(y, u, prior="window")
    assert run.status[:, 0].tolist() == [Status.COLD_START, Status.ILL_CONDITIONED, Status.COLD_START]
    assert np.isfinite(run.x).all()
    with pytest.warns(SecurestateWarning, match="the cold start is not certified"):
        KalmanFilter(plant).run(y[1], u, prior="window")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        KalmanFilter(plant).run(y[2], u, prior="window")


def test_inputs_of_each_run_are_its_own() -> None:
    plant = plant_of()
    y, u = records(plant, 2)
    own = np.stack([u, u + 0.01])
    batch = KalmanFilter(plant).run(y, own, prior="window")
    for i in range(2):
        np.testing.assert_array_equal(batch.x[i], KalmanFilter(plant).run(y[i], own[i], prior="window").x)


def test_live_filters_and_oracles_say_what_to_do_instead() -> None:
    plant, window = plant_of(), "window"
    any_prior: Any = window
    with pytest.raises(
        InputError, match=r"prior: expected a Belief or None; collect samples, call cold_start"
    ):
        KalmanFilter(plant).start(any_prior)
    y, u = records(plant, 1)
    with pytest.raises(InputError, match="prior: expected a Belief"):
        OracleFilter(plant).run(y[0], u, any_prior, attacked=np.zeros(5, dtype=bool))
    any_prior = "wide"
    with pytest.raises(InputError, match="prior"):
        KalmanFilter(plant).run(y[0], u, any_prior)


def test_a_plant_counted_from_a_later_sample() -> None:
    plant = plant_of(varying=True)
    assert plant.from_sample(0) == plant and plant_of().from_sample(7) == plant_of()
    np.testing.assert_array_equal(plant.from_sample(7).A, plant.A[7:])
    seen = Plant(np.eye(1), [[1.0]], [Sensor("a", C=np.arange(1.0, 6)[:, None, None], R=2.0, scale=3.0)])
    later_seen = seen.from_sample(2)
    assert later_seen.C[:, 0, 0].tolist() == [3, 4, 5] and later_seen.scale == 3 and later_seen.R == 2
    with pytest.raises(InputError, match=r"first: expected a sample in 0\.\.4, received 5"):
        seen.from_sample(5)
