"""ProtectedKalman: a Kalman filter of the protected sensors, and a fair test of all others."""

from typing import Any

import numpy as np
import pytest

from securestate import (
    Belief,
    DesignError,
    InputError,
    KalmanFilter,
    Plant,
    ProtectedKalman,
    ResumeError,
    Sensor,
)
from securestate.estimators import Run, Status
from tests.estimators.joint_cases import (
    Array,
    assert_close,
    random_data,
    random_plant,
    some_prior,
    varying_plant,
)
from tests.reference.protected_kalman import Textbook, judge

RATE = 0.05


def alone(plant: Plant) -> tuple[Plant, Array]:
    """The protected sensors' plant, and its channels."""
    sensors = np.flatnonzero(plant.protected).tolist()
    return plant.select(sensors), np.flatnonzero(plant.protected[plant.channel_sensor])


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_equals_the_kalman_filter_of_the_protected_sensors_to_the_bit(seed: int, missing: float) -> None:
    for plant, prior in (
        (random_plant(seed), None),
        (varying_plant(seed, 300), some_prior(random_plant(seed))),
    ):
        y, u = random_data(plant, 300, seed, missing=missing)
        y[40] = np.nan
        y[50, 3:] = np.nan
        selected, own = alone(plant)
        run, kalman = ProtectedKalman(plant).run(y, u, prior), KalmanFilter(selected).run(y[:, own], u, prior)
        for quantity in ("x", "x_std", "P", "status"):
            np.testing.assert_array_equal(getattr(run, quantity), getattr(kalman, quantity))
        for diagnostic, values in kalman.diagnostics.items():
            np.testing.assert_array_equal(run.diagnostics[diagnostic], values)
        assert_close(run.innovation[:, own], kalman.innovation, 1e-14)
        assert_close(run.innovation_std[:, own], kalman.innovation_std, 1e-12)
        assert run.status[50] == Status.NO_MEASUREMENT
        other = np.where(plant.protected[plant.channel_sensor], y, 1e9)
        np.testing.assert_array_equal(ProtectedKalman(plant).run(other, u, prior).x, run.x)


def assert_equals_textbook(run: Run, book: Textbook) -> None:
    plant = run.plant
    assert_close(run.attack, book.attack * plant.scale, 1e-9)
    np.testing.assert_allclose(run.attack_std, book.attack_std * plant.scale, rtol=1e-9)
    sent = ~np.isnan(run.innovation)
    for i, own in enumerate(map(plant.channels_of, range(plant.n_sensors))):
        arrived = sent[:, own].any(axis=1)
        if plant.protected[i]:
            np.testing.assert_array_equal(run.trust[:, i], np.where(arrived, 1.0, np.nan))
            assert not run.suspected[:, i].any()
        else:
            np.testing.assert_allclose(run.trust[:, i], 1 / (1 + book.excess[:, i]), rtol=1e-8)
            np.testing.assert_array_equal(run.suspected[:, i], book.excess[:, i] > 1)
    assert run.suspected.any() and not run.suspected.all()


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_attacks_and_distances_equal_the_textbook(seed: int, varying: bool, missing: float) -> None:
    plant = varying_plant(seed, 200) if varying else random_plant(seed)
    (y, u), prior = random_data(plant, 200, seed, missing=missing), some_prior(plant)
    y[100:, :3] /= 4
    run = ProtectedKalman(plant, false_alarm_rate=RATE).run(y, u, prior)
    assert prior.P is not None
    assert_equals_textbook(run, judge(plant, y, u, prior.x, prior.P, RATE))


def test_noise_that_no_sensor_shares_and_engineering_units_equal_the_textbook() -> None:
    rng = np.random.default_rng(1)
    sensors = [
        Sensor("pair", C=rng.normal(size=(2, 2)), R=[1.0, 2.0], scale=[3.0, 0.2], offset=[5.0, -2.0]),
        Sensor("guard", C=[1.0, 0.3], R=0.5, protected=True, scale=7.0),
        Sensor("single", C=[0.0, 1.0], R=0.1, scale=0.5),
    ]
    plant = Plant([[0.9, 0.2], [0.0, 0.7]], np.eye(2), sensors, B=[[1.0], [0.5]], D=[[0.1], [0], [0.3], [0]])
    (y, u), prior = random_data(plant, 100, 1, missing=0.2), some_prior(plant)
    run = ProtectedKalman(plant, false_alarm_rate=RATE).run(plant.denormalise(y), u, prior)
    assert prior.P is not None
    assert_equals_textbook(run, judge(plant, y, u, prior.x, prior.P, RATE))


def honest(plant: Plant, T: int, seed: int) -> tuple[Array, Array]:
    rng, steady = np.random.default_rng(seed), KalmanFilter(alone(plant)[0]).steady
    assert steady is not None
    u, x = rng.normal(size=(T, plant.n_inputs)), np.empty((T, plant.n))
    w = rng.multivariate_normal(np.zeros(plant.n), plant.Q, T)
    v = rng.multivariate_normal(np.zeros(plant.m), plant.R, T)
    x[0], driven = rng.multivariate_normal(np.zeros(plant.n), steady.P_prior), u @ plant.B.T + w
    for k in range(T - 1):
        x[k + 1] = plant.A @ x[k] + driven[k]
    return x @ plant.C.T + u @ plant.D.T + v, u


def test_an_injection_is_estimated_without_bias_and_within_its_deviation() -> None:
    plant, T = random_plant(5), 40_000
    y, u = honest(plant, T, 5)
    lie = np.where(np.arange(plant.m) < 3, 1.0, 0.0) * np.random.default_rng(0).normal(size=(T, plant.m)) * 50
    run = ProtectedKalman(plant).run(y + lie, u, covariance=False)
    error = (run.attack - lie)[:, :3] / run.attack_std[:, :3]
    assert np.abs(error.mean(axis=0)).max() < 0.02
    np.testing.assert_allclose(error.std(axis=0), 1.0, rtol=0.02)
    np.testing.assert_allclose((np.abs(error) < 1.96).mean(axis=0), 0.95, atol=0.005)


@pytest.mark.parametrize("rate", [0.05, 0.01])
def test_honest_sensors_raise_as_many_alarms_as_stated(rate: float) -> None:
    plant = random_plant(6)
    y, u = honest(plant, 60_000, 6)
    y[:, 0] += np.where(np.random.default_rng(1).random(60_000) < 0.5, 1e6, 0.0)
    run = ProtectedKalman(plant, false_alarm_rate=rate).run(y, u, covariance=False)
    assert run.suspected[:, 1].mean() == pytest.approx(rate, rel=0.1)
    assert run.suspected[y[:, 0] > 1e5, 0].all() and not run.suspected[:, 2:].any()


def test_an_outlier_beyond_all_sizes_is_suspected() -> None:
    plant = random_plant(7)
    y, u = random_data(plant, 20, 7)
    y[10, 0], y[11, 2], y[12, :2] = 1e300, -1e300, [1e200, -1e300]
    run = ProtectedKalman(plant).run(y, u)
    assert run.suspected[10, 0] and run.suspected[11, 1] and run.suspected[12, 0]
    assert run.trust[10, 0] < 1e-200 and run.trust[11, 1] < 1e-200
    assert np.isfinite(run.attack).all() and np.isfinite(run.x).all()


def test_trust_and_attack_are_unknown_where_nothing_arrived() -> None:
    plant = random_plant(8)
    y, u = random_data(plant, 3, 8)
    y[0, 0] = np.nan  # one channel of two
    y[1, :3] = np.nan
    y[2] = np.nan
    run = ProtectedKalman(plant).run(y, u)
    np.testing.assert_array_equal(np.isnan(run.trust), [[0, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 1]])
    np.testing.assert_array_equal(np.isnan(run.attack), np.isnan(y))
    np.testing.assert_array_equal(np.isnan(run.attack_std), np.isnan(y))
    assert run.status.tolist() == [Status.OK, Status.OK, Status.NO_MEASUREMENT]


def test_live_steps_saved_states_and_batches_continue_to_the_bit() -> None:
    plant = random_plant(9, radius=0.5)
    estimator = ProtectedKalman(plant)
    pairs = [random_data(plant, 300, run, missing=0.02 * run) for run in range(3)]
    y, u = np.stack([pair[0] for pair in pairs]), pairs[0][1]
    names = ("x", "P", "trust", "suspected", "attack", "attack_std", "innovation", "innovation_std", "status")
    for prior in (None, some_prior(plant)):
        batch = estimator.run(y, u, prior)
        for run in range(3):
            live, parts = estimator.start(prior), []
            for k in range(300):
                parts.append(live.step(y[run, k], u[k]))
                if k % 29 == 0:
                    live = estimator.resume(live.save())
            single = estimator.run(y[run], u, prior)
            for name in names:
                np.testing.assert_array_equal([getattr(part, name) for part in parts], getattr(single, name))
                np.testing.assert_array_equal(getattr(batch, name)[run], getattr(single, name))
    with pytest.raises(ResumeError, match="another"):
        ProtectedKalman(plant, false_alarm_rate=0.1).resume(estimator.start().save())


def test_if_everybody_is_protected_it_is_the_kalman_filter() -> None:
    plain = random_plant(3)
    sensors = [Sensor(s.name, C=s.C, protected=True) for s in plain.sensors]
    plant = Plant(plain.A, plain.Q, sensors, B=plain.B, D=plain.D, R=plain.R)
    y, u = random_data(plant, 50, 3, missing=0.1)
    run, kalman = ProtectedKalman(plant).run(y, u), KalmanFilter(plant).run(y, u)
    np.testing.assert_array_equal(run.x, kalman.x)
    np.testing.assert_array_equal(run.trust, kalman.trust)
    np.testing.assert_array_equal(run.attack, np.where(np.isnan(y), np.nan, 0.0))


def test_what_it_cannot_be_designed_for_is_refused() -> None:
    sensors = [Sensor("a", C=[1.0], R=1.0)]
    with pytest.raises(DesignError, match="no sensor of this plant is protected"):
        ProtectedKalman(Plant([[0.5]], [[1.0]], sensors))
    bad: Any = "plant.toml"
    with pytest.raises(InputError, match="plant: expected a Plant"):
        ProtectedKalman(bad)
    with pytest.raises(InputError, match=r"false_alarm_rate: expected a number in \(0, 1\), received 0"):
        ProtectedKalman(random_plant(1), false_alarm_rate=0)
    unseen = Plant(
        np.diag([2.0, 0.5]),
        np.eye(2),
        [Sensor("w", C=[1.0, 0.0], R=1.0), Sensor("p", C=[0.0, 1.0], R=1.0, protected=True)],
    )
    estimator = ProtectedKalman(unseen)
    assert estimator.steady is None and "mode 2" in estimator.no_steady_state
    with pytest.raises(InputError, match="prior: expected a belief with a covariance P"):
        estimator.run([[0.0, 0.0]])
    run = estimator.run(np.zeros((700, 2)), prior=Belief(np.zeros(2), np.eye(2)))
    assert run.status[0] == Status.OK and run.status[-1] == Status.ILL_CONDITIONED
    assert run.trust[0, 0] == 1 and np.isnan(run.trust[-1, 0]) and not run.suspected.any()
