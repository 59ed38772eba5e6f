"""Injections as states of a Kalman filter: the textbook, the published errors, and what is refused."""

from typing import Any

import numpy as np
import pytest

from securestate import (
    AugmentedKalman,
    Belief,
    DesignError,
    InputError,
    KalmanFilter,
    Plant,
    ResumeError,
    Sensor,
)
from securestate.estimators._augmented import augmented_plant
from tests.estimators import attack_cases as cases
from tests.estimators.kalman_cases import Array, some_prior
from tests.reference import attack_as_state as book

NOISE, START = {"s0": 0.5, "s1": 2.0}, 3.0
PER_CHANNEL = np.array([0.5, 0.5, 2.0, 2.0])


@pytest.fixture(scope="module")
def four_bus() -> tuple[Plant, Belief, Array, Array]:
    return cases.four_bus_runs(2500, seed=7)


@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_equals_the_textbook(seed: int, missing: float, varying: bool) -> None:
    T = 80
    plant = cases.varying_plant(seed, T) if varying else cases.weak_plant(seed)
    (y, u), prior = cases.attacked_data(plant, T, seed, missing=missing), some_prior(plant)
    run = AugmentedKalman(plant, attack_noise=NOISE, attack_start=START, false_alarm_rate=0.05).run(
        y, u, prior
    )
    s = book.augmented(plant, PER_CHANNEL, T)
    theta = (PER_CHANNEL + START) / plant.scale[s.weak] ** 2
    expected = book.kalman(s, plant.normalise(y), u, *cases.begin(plant, prior, theta))
    cases.assert_equals(run, expected, s, 0.05)
    assert run.suspected.any() and not run.suspected.all()


def test_is_the_kalman_filter_of_the_augmented_plant_to_the_bit() -> None:
    plant = cases.weak_plant(1)
    y, u = cases.attacked_data(plant, 100, 1, missing=0.1)
    estimator = AugmentedKalman(plant, attack_noise=[0.5, 2.0])
    whole = augmented_plant(plant, np.arange(4), PER_CHANNEL / plant.scale[:4] ** 2)
    run, kalman = estimator.run(y, u), KalmanFilter(whole).run(y, u)
    assert kalman.P is not None
    np.testing.assert_array_equal(run.x, kalman.x[:, :4])
    np.testing.assert_array_equal(run.x_std, kalman.x_std[:, :4])
    np.testing.assert_array_equal(run.P, kalman.P[:, :4, :4])
    theta = np.where(np.isnan(y[:, :4]), np.nan, kalman.x[:, 4:] * plant.scale[:4])
    np.testing.assert_array_equal(run.attack[:, :4], theta)
    for quantity in ("innovation", "innovation_std", "status"):
        np.testing.assert_array_equal(getattr(run, quantity), getattr(kalman, quantity))
    assert whole.state_names[4:] == tuple(f"attack on s{i}.{j}" for i in (0, 1) for j in (1, 2))


@pytest.mark.parametrize("row", cases.PUBLISHED["augmented"], ids=lambda row: f"q={row['attack_noise']}")
def test_the_state_error_is_that_of_an_independent_program(
    row: dict[str, float], four_bus: tuple[Plant, Belief, Array, Array]
) -> None:
    estimator = AugmentedKalman(four_bus[0], attack_noise=row["attack_noise"], attack_start=1.0)
    cases.assert_published(estimator, row, four_bus)


@pytest.mark.parametrize(("q", "low"), [(0.01, 0.0), (10.0, 0.03)])
def test_honest_sensors_raise_no_more_alarms_than_stated(q: float, low: float) -> None:
    plant, _, _, y = cases.four_bus_runs(200, seed=1, variance=0.0)
    run = AugmentedKalman(plant, attack_noise=q, false_alarm_rate=0.05).run(y)
    assert low < run.suspected[:, 20:, 0].mean() < 0.05
    assert not run.suspected[..., 1:].any()


def test_batch_equals_loop_and_resumed_runs_to_the_bit() -> None:
    plant = cases.weak_plant(2)
    cases.assert_batch_is_loop_and_resumes(AugmentedKalman(plant), None)
    cases.assert_batch_is_loop_and_resumes(
        AugmentedKalman(plant, attack_noise=0, attack_start=1), some_prior(plant)
    )
    varied = cases.varying_plant(2, 150)
    cases.assert_batch_is_loop_and_resumes(AugmentedKalman(varied), some_prior(varied))


def test_outliers_and_silence_leave_numbers() -> None:
    plant = cases.weak_plant(3)
    cases.assert_numbers_stay_numbers(AugmentedKalman(plant), None)
    cases.assert_numbers_stay_numbers(
        AugmentedKalman(plant, attack_noise=0, attack_start=1), some_prior(plant)
    )


def test_a_state_of_other_settings_is_refused() -> None:
    plant = cases.weak_plant(1)
    blob = AugmentedKalman(plant).start().save()
    for settings in ({"attack_noise": 2.0}, {"attack_start": 2.0}, {"false_alarm_rate": 0.1}):
        with pytest.raises(ResumeError, match="another"):
            AugmentedKalman(plant, **settings).resume(blob)


def test_settings_say_what_was_understood() -> None:
    plant = cases.weak_plant(1)
    assert AugmentedKalman(plant).settings == {
        "attack_noise": 1.0,
        "attack_start": 1.0,
        "false_alarm_rate": 0.01,
    }
    assert AugmentedKalman(plant, attack_noise=[0.5, 2]).settings["attack_noise"] == NOISE


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"attack_noise": -1.0}, "attack_noise: expected variances >= 0, received -1.0"),
        ({"attack_noise": [1.0, 2.0, 3.0]}, "attack_noise: expected one number or 2, one per sensor that"),
        ({"attack_noise": {"s0": 1.0}}, "attack_noise: expected the weak sensors s0, s1, received s0"),
        ({"attack_noise": float("nan")}, "attack_noise: expected finite numbers"),
        ({"attack_noise": 0.0}, "attack_start: expected a number > 0 where attack_noise is 0"),
        ({"attack_start": "1"}, "attack_start: expected an array of real numbers"),
        ({"false_alarm_rate": 0.0}, "false_alarm_rate"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        AugmentedKalman(cases.weak_plant(1), **settings)


def test_plants_on_which_an_attack_cannot_be_told_are_refused_by_name() -> None:
    def plant(A: Array, *protected: bool) -> Plant:
        sensors = [Sensor(f"s{i}", C=np.eye(2)[i], R=1.0, protected=p) for i, p in enumerate(protected)]
        return Plant(A, np.eye(2), sensors, state_names=["level", "flow"])

    with pytest.raises(InputError, match="plant: expected a Plant"):
        AugmentedKalman("plant.toml")  # type: ignore[arg-type]
    with pytest.raises(DesignError, match="every sensor is protected"):
        AugmentedKalman(plant(np.eye(2), True, True))
    with pytest.raises(DesignError, match="no sensor is protected"):
        AugmentedKalman(plant(np.eye(2), False, False))
    with pytest.raises(DesignError, match=r"no protected sensor sees mode 1 \(level\), so that a constant"):
        AugmentedKalman(plant(np.diag([1.0, 0.5]), False, True))
    with pytest.raises(DesignError, match=r"no sensor sees mode 1.2 \(x2\)"):
        sensors = [Sensor("a", C=[1.0, 0.0], R=1.0), Sensor("b", C=[1.0, 0.0], R=1.0, protected=True)]
        AugmentedKalman(Plant(np.diag([0.5, 1.2]), np.eye(2), sensors))
    fading = plant(np.diag([0.9, 0.5]), False, True)
    assert AugmentedKalman(fading).no_steady_state == ""
    still = AugmentedKalman(fading, attack_noise=0.0, attack_start=1.0)
    assert "attack on s0" in still.no_steady_state
    with pytest.raises(InputError, match="prior: expected a belief with a covariance P"):
        still.run([[0.0, 0.0]])
