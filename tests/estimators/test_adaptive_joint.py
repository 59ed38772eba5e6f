"""The adaptive filter: equality with the textbook, and what no input can break."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from securestate import (
    AdaptiveJointFilter,
    Belief,
    DesignError,
    InputError,
    KalmanFilter,
    MeasurementError,
    Plant,
    ResumeError,
    Run,
    SecurestateWarning,
    Sensor,
    Status,
)
from tests.estimators.kalman_cases import random_data, random_plant, some_prior
from tests.reference.adaptive_joint import Textbook, adaptive_joint

FOUR_BUS = Plant.load(Path(__file__).parents[2] / "examples/four-bus/plant.toml")


def guarded(plant: Plant, protected: list[int], **changed: Any) -> Plant:
    """The same plant with these sensors protected."""
    C = changed.pop("C", plant.C)
    sensors = [
        Sensor(sensor.name, C=C[..., plant.channels_of(i), :], protected=i in protected)
        for i, sensor in enumerate(plant.sensors)
    ]
    return Plant(changed.pop("A", plant.A), plant.Q, sensors, B=plant.B, D=plant.D, R=plant.R)


def assert_equals_textbook(run: Run, book: Textbook, tolerance: float = 1e-8) -> None:
    for name in ("x", "P", "attack", "attack_std", "innovation", "innovation_std"):
        expected = getattr(book, name)
        size = max(np.nanmax(np.abs(expected)), 1.0)
        np.testing.assert_allclose(getattr(run, name), expected, rtol=0, atol=tolerance * size, err_msg=name)
    for name in ("log_likelihood", "nis", "eta"):
        np.testing.assert_allclose(
            run.diagnostics[name], getattr(book, name), rtol=tolerance, atol=tolerance, err_msg=name
        )
    trust = np.where(np.isnan(book.excess), run.trust, 1 / (1 + book.excess))
    np.testing.assert_allclose(run.trust, trust, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(run.suspected, book.excess > 1)


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("protected", [[0], [1], [0, 2], [0, 1, 2]])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.filterwarnings("ignore::securestate.SecurestateWarning")
def test_correlated_sensors_with_inputs_equal_the_textbook(
    seed: int, protected: list[int], missing: float
) -> None:
    plant = guarded(random_plant(seed, m=6 if seed % 2 else 3), protected)  # two channels per sensor, or one
    (y, u), prior = random_data(plant, 80, seed, missing=missing), some_prior(plant)
    assert prior.P is not None
    run = AdaptiveJointFilter(plant, window=7, gate=4.0, false_alarm_rate=0.02).run(y, u, prior)
    assert_equals_textbook(run, adaptive_joint(plant, y, u, prior.x, prior.P, 7, 4.0, 0.02))


def test_a_time_varying_plant_equals_the_textbook() -> None:
    plant, T, rng = random_plant(3), 60, np.random.default_rng(3)
    A = plant.A + 0.05 * rng.normal(size=(T, 4, 4))
    varied = guarded(plant, [1], A=A, C=plant.C + 0.5 * rng.normal(size=(T, 6, 4)))
    (y, u), prior = random_data(varied, T, 3, missing=0.1), some_prior(varied)
    assert prior.P is not None
    estimator = AdaptiveJointFilter(varied)
    assert_equals_textbook(
        estimator.run(y, u, prior), adaptive_joint(varied, y, u, prior.x, prior.P, 20, 9.0, 0.01)
    )
    with pytest.raises(MeasurementError, match="at most 60 samples"):
        estimator.run(np.vstack([y, y[:1]]), np.vstack([u, u[:1]]), prior)
    with pytest.raises(InputError, match="prior: expected a belief with a covariance P"):
        estimator.run(y, u)


def test_without_a_weak_sensor_it_is_the_kalman_filter() -> None:
    plant = guarded(random_plant(2), [0, 1, 2])
    y, u = random_data(plant, 200, 2, missing=0.1)
    run, kalman = AdaptiveJointFilter(plant).run(y, u), KalmanFilter(plant).run(y, u)
    for name in ("x", "P", "trust", "innovation", "innovation_std", "status"):
        np.testing.assert_allclose(getattr(run, name), getattr(kalman, name), rtol=1e-11, atol=1e-12)
    for name, values in kalman.diagnostics.items():
        np.testing.assert_allclose(run.diagnostics[name], values, rtol=1e-11)
    np.testing.assert_array_equal(run.attack, np.where(np.isnan(y), np.nan, 0.0))
    assert not run.diagnostics["eta"].any() and not run.suspected.any()


def test_without_a_prior_it_starts_from_the_steady_state_of_all_sensors() -> None:
    plant = guarded(random_plant(1), [0])
    y, u = random_data(plant, 3, 1)
    steady = KalmanFilter(plant).steady
    assert steady is not None
    estimator = AdaptiveJointFilter(plant)
    told = estimator.run(y, u, Belief(np.zeros(4), steady.P_prior))
    np.testing.assert_allclose(estimator.run(y, u).x, told.x, rtol=1e-10)


def test_batch_equals_loop_to_the_bit() -> None:
    plant = guarded(random_plant(7), [1])
    estimator = AdaptiveJointFilter(plant)
    y = np.stack([random_data(plant, 1100, seed, missing=0.05 * seed)[0] for seed in range(3)])
    u = random_data(plant, 1100, 0)[1]
    batch = estimator.run(y, u)
    for r in range(3):
        single = estimator.run(y[r], u)
        for name in ("x", "P", "trust", "attack", "attack_std", "suspected", "innovation_std", "status"):
            np.testing.assert_array_equal(getattr(batch, name)[r], getattr(single, name))
        for name, values in batch.diagnostics.items():
            np.testing.assert_array_equal(values[r], single.diagnostics[name])


def test_save_and_resume_continue_to_the_bit() -> None:
    plant = guarded(random_plant(5), [0])
    estimator = AdaptiveJointFilter(plant, window=6)
    y, u = random_data(plant, 200, 5, missing=0.2)
    whole, live, parts = estimator.run(y, u), estimator.start(), []
    for k in range(200):
        parts.append(live.step(y[k], u[k]))
        if k % 7 == 0:
            live = estimator.resume(live.save())
    for name in ("x", "P", "trust", "attack", "attack_std", "suspected"):
        np.testing.assert_array_equal([getattr(e, name) for e in parts], getattr(whole, name))
    assert [e.diagnostics["eta"] for e in parts] == list(whole.diagnostics["eta"])


def test_a_state_of_other_settings_is_refused() -> None:
    plant = guarded(random_plant(1), [0])
    settings: list[dict[str, Any]] = [{}, {"window": 21}, {"gate": 8.0}]
    designs = [AdaptiveJointFilter(plant, **one) for one in settings]
    designs += [AdaptiveJointFilter(plant, false_alarm_rate=0.02)]
    designs += [AdaptiveJointFilter(guarded(random_plant(1), [0, 2]))]
    for i, estimator in enumerate(designs):
        for j, other in enumerate([*designs, KalmanFilter(plant)]):
            if i == j:
                estimator.resume(other.start().save())
            else:
                with pytest.raises(ResumeError, match="another"):
                    estimator.resume(other.start().save())


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.filterwarnings("ignore::securestate.SecurestateWarning")
def test_readings_of_any_size_give_numbers_and_a_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = guarded(random_plant(seed), [[0], [1], [0, 2]][seed % 3])
    y, u = random_data(plant, 200, seed, missing=0.1)
    huge = rng.random(y.shape) < 0.2
    y[huge] = np.sign(y[huge]) * 10.0 ** rng.uniform(-300, 300, size=huge.sum())
    y[rng.random(200) < 0.1] = np.nan
    prior = Belief(np.zeros(4), 10.0 ** rng.uniform(-8, 20) * np.eye(4)) if seed % 4 else None
    window, gate = int(rng.integers(1, 30)), float(rng.choice([0.5, 9.0, math.inf]))
    run = AdaptiveJointFilter(plant, window=window, gate=gate).run(y, u, prior)
    assert run.P is not None
    for numbers in (run.x, run.x_std, run.P, run.innovation_std, run.diagnostics["eta"]):
        assert np.isfinite(numbers).all()
    for numbers in (run.attack, run.attack_std, run.innovation):
        np.testing.assert_array_equal(np.isfinite(numbers), ~np.isnan(y))
    assert not any(np.isnan(values).any() for values in run.diagnostics.values())
    sizes = np.linalg.eigvalsh(run.P)
    assert (sizes >= -1e-12 * sizes[:, -1:]).all()
    none = np.isnan(y).all(axis=1)
    np.testing.assert_array_equal(run.status, np.where(none, Status.NO_MEASUREMENT, Status.OK))


def test_a_weak_reading_of_any_size_has_no_weight_and_does_not_touch_what_others_say() -> None:
    plant = guarded(random_plant(4), [1])
    y, u = random_data(plant, 3, 4)
    silent, shouting = y.copy(), y.copy()
    silent[2, 0], shouting[2, 0] = np.nan, 1e300
    run, other = AdaptiveJointFilter(plant).run(shouting, u), AdaptiveJointFilter(plant).run(silent, u)
    np.testing.assert_allclose(run.x, other.x, rtol=1e-12)
    np.testing.assert_allclose(run.attack[2, 1:], other.attack[2, 1:], rtol=1e-9)
    assert run.suspected[2, 0] and run.trust[2, 0] < 1e-200


def test_status_is_that_of_the_kalman_filter_where_no_sensor_sees_a_growing_mode() -> None:
    sensors = [
        Sensor("weak", C=[[1.0, 0.0], [1.0, 0.0]], R=1.0),
        Sensor("guarded", C=[1.0, 0.0], R=1.0, protected=True),
    ]
    plant = Plant([[0.9, 0.0], [0.0, 2.0]], np.eye(2), sensors)
    with pytest.warns(SecurestateWarning, match="do not see mode 2 "):
        estimator = AdaptiveJointFilter(plant)
    y, prior = random_data(plant, 1200, 0)[0], Belief(np.zeros(2), np.eye(2))
    run = estimator.run(y, prior=prior)
    np.testing.assert_array_equal(run.status, KalmanFilter(plant).run(y, prior=prior).status)
    assert set(run.status) == {Status.OK, Status.ILL_CONDITIONED}
    assert np.isfinite(run.diagnostics["eta"]).all() and not np.isnan(run.trust).any()


@pytest.mark.parametrize("channels", [1, 2])
def test_honest_sensors_are_suspected_as_often_as_stated(channels: int) -> None:
    plant, T = rate_plant(channels), 100_000
    steady = KalmanFilter(plant).steady
    assert steady is not None
    rng = np.random.default_rng(channels)
    noise = rng.multivariate_normal(np.zeros(plant.m), plant.R, size=T)
    x, w = np.empty((T, 2)), rng.multivariate_normal(np.zeros(2), plant.Q, size=T)
    x[0] = rng.multivariate_normal(np.zeros(2), steady.P_prior)
    for k in range(1, T):
        x[k] = plant.A @ x[k - 1] + w[k]
    y = x @ plant.C.T + noise
    for rate in (0.05, 0.01, 0.001):
        run = AdaptiveJointFilter(plant, false_alarm_rate=rate).run(y, covariance=False)
        alarms = run.suspected[:, ~plant.protected]
        spread = 4 * np.sqrt(rate / alarms.size)
        assert 0.97 * rate - spread < alarms.mean() < 1.03 * rate + spread
        assert not run.suspected[:, plant.protected].any()


def rate_plant(channels: int) -> Plant:
    C = np.random.default_rng(channels).normal(size=(6, channels, 2)) + np.array([1.0, 0.0])
    sensors = [Sensor(f"s{i}", C=c, R=np.eye(channels) + 0.3, protected=i < 2) for i, c in enumerate(C)]
    return Plant([[0.9, 0.2], [0.0, 0.8]], np.diag([0.5, 1.0]), sensors)


def test_the_attack_is_in_the_units_of_its_sensor() -> None:
    sensors = [
        Sensor("weak", C=[1.0], R=1.0, offset=7.0, scale=2.0),
        Sensor("guarded", C=[1.0], R=3.0, protected=True),
    ]
    run = AdaptiveJointFilter(Plant([[0.0]], [[1.0]], sensors)).run([[107.0, 4.0], [np.nan, 0.0]])
    # given the guarded reading 4 the state is N(1, 3/4): nu = 50 - 1 and S = 3/4 + 1, twice that in the file
    np.testing.assert_allclose(run.attack, [[98.0, 0.0], [np.nan, 0.0]])
    np.testing.assert_allclose(run.attack_std, [[2 * math.sqrt(1.75), 0.0], [np.nan, 0.0]])
    np.testing.assert_allclose(run.diagnostics["eta"], [49**2 - 1.75, 0.0])
    np.testing.assert_array_equal(run.suspected, [[True, False], [False, False]])
    np.testing.assert_array_equal(np.isnan(run.trust), [[False, False], [True, False]])


def test_a_plant_without_a_protected_sensor_is_refused_with_advice() -> None:
    with pytest.raises(DesignError, match=r"no sensor is protected.*protected=True.*SparseFusion"):
        AdaptiveJointFilter(random_plant(1))
    with pytest.raises(InputError, match="plant: expected a Plant"):
        AdaptiveJointFilter("plant.toml")  # type: ignore[arg-type]


def test_a_mode_that_only_weak_sensors_see_is_named() -> None:
    sensors = [Sensor("a", C=[1.0, 1.0], R=1.0), Sensor("b", C=[0.0, 1.0], R=1.0, protected=True)]
    plant = Plant([[1.0, 0.0], [0.0, 0.5]], np.eye(2), sensors, state_names=["mass", "heat"])
    with pytest.warns(SecurestateWarning, match=r"do not see mode 1 \(mass\)"):
        AdaptiveJointFilter(plant)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"window": 0}, "window: expected a whole number >= 1, received 0"),
        ({"window": 2.5}, "window"),
        ({"window": 10_001}, "window: expected a whole number up to 10000"),
        ({"gate": 0.0}, "gate: expected a number > 0"),
        ({"gate": float("nan")}, "gate"),
        ({"gate": "9"}, "gate"),
        ({"false_alarm_rate": 1}, "false_alarm_rate"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        AdaptiveJointFilter(FOUR_BUS, **settings)


def test_settings_say_what_was_chosen() -> None:
    assert AdaptiveJointFilter(FOUR_BUS).settings == {"window": 20, "gate": 9.0, "false_alarm_rate": 0.01}
