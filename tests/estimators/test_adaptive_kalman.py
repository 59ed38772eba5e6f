"""Zhang's adaptive filter: the textbook, the published errors, what P means, and when it gives up."""

from typing import Any

import numpy as np
import pytest

from securestate import (
    AdaptiveKalman,
    AugmentedKalman,
    Belief,
    InputError,
    Plant,
    ResumeError,
    Sensor,
    Status,
)
from tests.estimators import attack_cases as cases
from tests.estimators.kalman_cases import Array, some_prior
from tests.reference import attack_as_state as book

NOISE, START, DRIFT = np.array([0.5, 2.0]), 3.0, np.array([0.2, 0.7])


@pytest.fixture(scope="module")
def four_bus() -> tuple[Plant, Belief, Array, Array]:
    return cases.four_bus_runs(2500, seed=8)


@pytest.mark.parametrize("forgetting", [0.9, 1.0])
@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(3))
def test_equals_the_textbook(seed: int, missing: float, varying: bool, forgetting: float) -> None:
    T = 80
    plant = cases.varying_plant(seed, T) if varying else cases.weak_plant(seed)
    (y, u), prior = cases.attacked_data(plant, T, seed, missing=missing), some_prior(plant)
    settings: dict[str, Any] = {"attack_noise": NOISE, "attack_start": START, "drift_start": DRIFT}
    run = AdaptiveKalman(plant, forgetting=forgetting, false_alarm_rate=0.05, **settings).run(y, u, prior)
    s = book.augmented(plant, NOISE.repeat(2), T)
    units = plant.scale[s.weak] ** 2
    X, P = cases.begin(plant, prior, (NOISE.repeat(2) + START) / units)
    drift = np.diag(DRIFT.repeat(2) / units)
    expected = book.zhang(s, plant.normalise(y), u, X, P, drift=drift, forgetting=forgetting)
    cases.assert_equals(run, expected, s, 0.05)
    assert not (run.status == Status.BROKEN_DOWN).any()


@pytest.mark.parametrize(
    "row", cases.PUBLISHED["adaptive"], ids=lambda row: f"{row['forgetting']}, q={row['attack_noise']}"
)
def test_the_state_error_is_that_of_an_independent_program(
    row: dict[str, float], four_bus: tuple[Plant, Belief, Array, Array]
) -> None:
    estimator = AdaptiveKalman(four_bus[0], forgetting=row["forgetting"], attack_noise=row["attack_noise"])
    cases.assert_published(estimator, row, four_bus)


@pytest.mark.parametrize(("forgetting", "low", "high"), [(1.0, 0.93, 1.07), (0.9, 0.3, 1.0)])
def test_p_is_the_error_of_a_constant_drift_or_above_it(forgetting: float, low: float, high: float) -> None:
    runs, steps, rng = 4000, 40, np.random.default_rng(3)
    sensors = [Sensor("a", C=[1.0], R=1.0), Sensor("b", C=[1.0], R=1.0, protected=True)]
    plant, drift = Plant([[0.9]], [[1.0]], sensors), rng.normal(size=runs)
    noise = 0.1 * rng.normal(size=(steps, runs))
    noise[0] = np.sqrt(2.0) * rng.normal(size=runs)  # attack_start and one increment
    theta = np.cumsum(drift + noise, axis=0)
    x = np.empty((steps, runs))
    x[0] = rng.normal(size=runs)
    for k in range(1, steps):
        x[k] = 0.9 * x[k - 1] + rng.normal(size=runs)
    y = np.stack([x + theta, x], axis=2) + rng.normal(size=(steps, runs, 2))
    estimator = AdaptiveKalman(plant, forgetting=forgetting, attack_noise=0.01, attack_start=1.99)
    run = estimator.run(np.swapaxes(y, 0, 1), prior=Belief([0.0], [[1.0]]))
    ratio = np.mean((run.attack[:, -1, 0] - theta[-1]) ** 2) / run.attack_std[0, -1, 0] ** 2
    assert low < ratio < high
    assert low < np.mean((run.x[:, -1, 0] - x[-1]) ** 2) / run.x_std[0, -1, 0] ** 2 < high


def test_a_ramp_is_followed_without_lag_where_the_white_increment_lags() -> None:
    plant = Plant.load(cases.ROOT / "examples/four-bus/plant.toml").select([0, 2, 3])
    y = np.zeros((300, 3))
    y[:, 0] = 0.5 * np.arange(300)
    lag = AugmentedKalman(plant, attack_noise=0.01).run(y).attack[-1, 0] - y[-1, 0]
    adaptive = AdaptiveKalman(plant).run(y)
    assert abs(adaptive.attack[-1, 0] - y[-1, 0]) < 1e-3 < 1 < abs(lag)
    assert adaptive.suspected[100:, 0].all() and not adaptive.suspected[:, 1:].any()


def test_batch_equals_loop_and_resumed_runs_to_the_bit() -> None:
    plant = cases.weak_plant(2)
    cases.assert_batch_is_loop_and_resumes(AdaptiveKalman(plant), None)
    cases.assert_batch_is_loop_and_resumes(AdaptiveKalman(plant, attack_noise=0), some_prior(plant))
    varied = cases.varying_plant(2, 150)
    cases.assert_batch_is_loop_and_resumes(AdaptiveKalman(varied), some_prior(varied))


@pytest.mark.parametrize("forgetting", [1e-3, 0.5, 0.95, 1.0])
def test_outliers_and_silence_leave_numbers(forgetting: float) -> None:
    plant = cases.weak_plant(3)
    cases.assert_numbers_stay_numbers(AdaptiveKalman(plant, forgetting=forgetting), None)


def test_silence_does_not_inflate_the_drift() -> None:
    plant = cases.weak_plant(3)
    y, u = cases.attacked_data(plant, 3000, 0)
    y[100:] = np.nan
    run = AdaptiveKalman(plant, forgetting=0.9).run(y, u)
    assert (run.status[100:] == Status.NO_MEASUREMENT).all()
    assert run.x_std.max() < 1e4


def test_a_drift_that_nothing_tells_any_more_breaks_down_and_starts_anew() -> None:
    sensors = [Sensor("open", C=[1.0, 0.0], R=1.0), Sensor("sealed", C=[1.0, 0.0], R=1.0, protected=True)]
    plant = Plant([[1.0, 1.0], [0.0, 1.0]], 0.1 * np.eye(2), sensors)
    y = np.random.default_rng(0).normal(size=(1500, 2))
    y[50:, 1] = np.nan  # a ramp of the lie and of the position look the same from here on
    settings: dict[str, Any] = {"forgetting": 0.9, "attack_noise": 0.01}
    run, prior = AdaptiveKalman(plant, **settings), Belief([0.0, 0.0], np.eye(2))
    adaptive = run.run(y, prior=prior)
    broken = adaptive.status == Status.BROKEN_DOWN
    assert 1 <= broken.sum() <= 10 and not broken[:200].any()
    plain = AugmentedKalman(plant, attack_noise=0.01, attack_start=1.0).run(y, prior=prior)
    for quantity in ("x", "P", "attack", "attack_std", "innovation", "innovation_std"):
        np.testing.assert_array_equal(getattr(adaptive, quantity)[broken], getattr(plain, quantity)[broken])
    assert np.isfinite(adaptive.x).all() and np.isfinite(adaptive.x_std).all()


def test_a_state_of_other_settings_or_of_the_filter_without_drift_is_refused() -> None:
    plant = cases.weak_plant(1)
    blob = AdaptiveKalman(plant).start().save()
    others = [AdaptiveKalman(plant, forgetting=0.9), AdaptiveKalman(plant, drift_start=2.0)]
    for other in [*others, AugmentedKalman(plant, attack_noise=0.01, attack_start=1.0)]:
        with pytest.raises(ResumeError, match="another"):
            other.resume(blob)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"forgetting": 0.0}, "forgetting: expected one number > 0"),
        ({"forgetting": 1.1}, r"forgetting: expected a number in \(0, 1\], received 1.1"),
        ({"forgetting": [0.9]}, "forgetting: expected one number > 0"),
        ({"drift_start": 0.0}, "drift_start: expected variances > 0, received 0.0"),
        ({"attack_noise": -0.1}, "attack_noise: expected variances >= 0"),
        ({"attack_start": {"s2": 1.0}}, "attack_start: expected the weak sensors s0, s1, received s2"),
        ({"false_alarm_rate": 2}, "false_alarm_rate"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        AdaptiveKalman(cases.weak_plant(1), **settings)


def test_settings_say_what_was_understood() -> None:
    assert AdaptiveKalman(cases.weak_plant(1)).settings == {
        "forgetting": 0.95,
        "attack_noise": 0.01,
        "attack_start": 1.0,
        "drift_start": 1.0,
        "false_alarm_rate": 0.01,
    }
