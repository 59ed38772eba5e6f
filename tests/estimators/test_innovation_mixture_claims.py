"""The innovation mixture: what a run promises."""

from typing import Any

import numpy as np
import pytest

from securestate import (
    Belief,
    DesignError,
    InnovationMixture,
    InputError,
    OracleFilter,
    Plant,
    ResumeError,
    Sensor,
    Status,
)
from tests.estimators.mixture_cases import Array, random_plant, simulate, some_prior
from tests.estimators.run_arrays import RUN_ARRAYS


def attacked_run(plant: Plant, seed: int, T: int = 60) -> tuple[Array, Array]:
    """Readings of which some sensors' are far off now and then, some missing; and inputs."""
    rng = np.random.default_rng(seed)
    _, y, u = simulate(plant, T, rng)
    lies = ((rng.random((T, plant.n_sensors)) < 0.2) & ~plant.protected)[:, plant.channel_sensor]
    y = np.where(lies, y + 8 * plant.scale * rng.normal(size=y.shape), y)
    y[rng.random(y.shape) < 0.05] = np.nan
    return y, u


def scalar_plant(seed: int, sensors: int = 15, **options: Any) -> Plant:
    """A plant of Section 4 of the paper."""
    rng = np.random.default_rng(seed)
    made = [Sensor(f"s{i}", C=[rng.uniform(1, 2)], R=rng.uniform(1, 2), **options) for i in range(sensors)]
    return Plant([[rng.uniform(0.4, 0.99)]], [[rng.uniform(0.5, 2)]], made)


def changing(rng: np.random.Generator, T: int, N: int, most: int) -> Array:
    """Who is attacked, (T, N): one to `most`, drawn anew at every sample."""
    rank = rng.random((T, N)).argsort(axis=1).argsort(axis=1)
    return rank < rng.integers(1, most + 1, size=(T, 1))


# ---------------------------------------------------------------- runs


@pytest.mark.parametrize("settings", [{}, {"memory": "sticky", "monitor": 0.9}, {"form": "belief"}])
def test_save_and_resume_continue_to_the_bit(settings: dict[str, Any]) -> None:
    plant = random_plant(1)
    y, u = attacked_run(plant, 1)
    estimator = InnovationMixture(plant, **settings)
    whole = estimator.run(y, u, some_prior(plant))
    live = estimator.start(some_prior(plant))
    live.run(y[:30], u[:30])
    rest = estimator.resume(live.save()).run(y[30:], u[30:])
    for name in RUN_ARRAYS:
        np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name)[30:], err_msg=name)


def test_a_batch_is_its_runs_to_the_bit() -> None:
    plant = random_plant(2)
    pairs = [attacked_run(plant, seed) for seed in range(20)]
    y, u = (np.stack(arrays) for arrays in zip(*pairs, strict=True))
    batch = InnovationMixture(plant).run(y, u)
    for i in range(len(y)):
        one = InnovationMixture(plant).run(y[i], u[i])
        for name in RUN_ARRAYS:
            np.testing.assert_array_equal(getattr(batch, name)[i], getattr(one, name), err_msg=name)


def test_a_state_does_not_resume_with_other_settings() -> None:
    plant = scalar_plant(0, 4)
    blob = InnovationMixture(plant).start().save()
    for settings in (
        {"form": "belief"},
        {"attacked": "student"},
        {"memory": "sticky"},
        {"memory": "doubt"},
        {"merge": False},
        {"kappa": 4.0},
        {"forgetting": 0.97},
        {"monitor": 0.9},
    ):
        with pytest.raises(ResumeError):
            InnovationMixture(plant, **settings).resume(blob)  # type: ignore[arg-type]


def test_the_order_of_the_sensors_does_not_matter() -> None:
    plant = scalar_plant(3, 7)
    y, _ = attacked_run(plant, 3)
    order = np.random.default_rng(0).permutation(7)
    other = Plant(plant.A, plant.Q, [plant.sensors[i] for i in order])
    run, turned = InnovationMixture(plant).run(y), InnovationMixture(other).run(y[:, order])
    np.testing.assert_allclose(turned.x, run.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(turned.trust, run.trust[:, order], rtol=0, atol=1e-9)


def test_units_do_not_matter() -> None:
    plant = scalar_plant(4, 7)
    y, _ = attacked_run(plant, 4)
    factor = 10.0 ** np.arange(-3, 4)
    sensors = [Sensor(s.name, C=f * s.C, R=f * f * s.R) for s, f in zip(plant.sensors, factor, strict=True)]
    run, scaled = (
        InnovationMixture(plant).run(y),
        InnovationMixture(Plant(plant.A, plant.Q, sensors)).run(y * factor),
    )
    np.testing.assert_allclose(scaled.x, run.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(scaled.trust, run.trust, rtol=0, atol=1e-9)
    np.testing.assert_allclose(scaled.attack / factor, run.attack, rtol=0, atol=1e-8)


def test_a_reading_beyond_all_bounds_counts_as_nothing() -> None:
    plant = scalar_plant(5, 9)
    _, y, _ = simulate(plant, 40, np.random.default_rng(5))
    wild, silent = y.copy(), y.copy()
    wild[:, 0], silent[:, 0] = 1e300, np.nan
    lost, without = InnovationMixture(plant).run(wild), InnovationMixture(plant).run(silent)
    assert lost.suspected[:, 0].all()
    np.testing.assert_allclose(lost.attack[:, 0], 1e300, rtol=1e-9)
    deviations = np.abs(lost.x - without.x) / without.x_std
    # It makes the attacked density broader for all others, and does no more.
    assert deviations.max() < 1 and deviations.mean() < 0.15


# ---------------------------------------------------------------- statuses


def equal_sensors(values: list[float], **options: Any) -> Any:
    sensors = [Sensor(f"s{i}", C=[1.0], R=0.01) for i in range(len(values))]
    prior = Belief([0.0], [[4.0]])
    return InnovationMixture(Plant([[1.0]], [[1.0]], sensors), **options).run([values], prior=prior)


def test_two_against_two_is_ambiguous_and_p_holds_both() -> None:
    run = equal_sensors([1.9, 2.0, -1.95, -2.05])
    other = equal_sensors([1.0, 1.0, -1.0, -1.0])
    assert run.status[0] == Status.AMBIGUOUS
    assert run.x_std[0, 0] > 1.8 and other.x_std[0, 0] > 0.9  # .05 if two sensors were believed


def test_a_majority_that_is_suspected_is_said() -> None:
    run = equal_sensors([30.0, -20.0, 11.0, 0.1, -44.0])
    assert run.status[0] == Status.MAJORITY_SUSPECT and run.suspected.sum() == 4


def test_nothing_heard_is_a_prediction() -> None:
    run = equal_sensors([np.nan] * 4)
    assert run.status[0] == Status.NO_MEASUREMENT and run.x[0, 0] == 0.0 and run.x_std[0, 0] == 2.0
    assert np.isnan(run.trust).all() and not run.suspected.any() and np.isnan(run.attack).all()


def test_a_prior_too_wide_for_the_digits_is_ill_conditioned() -> None:
    sensors = [Sensor(f"s{i}", C=[1.0], R=1e-6) for i in range(3)]
    estimator = InnovationMixture(Plant([[1.0]], [[1e-6]], sensors))
    wide, sane = (estimator.run([[1.0, 1.0, 1.0]], prior=Belief([0.0], [[P]])) for P in (1e9, 1e6))
    assert wide.status[0] == Status.ILL_CONDITIONED and sane.status[0] != Status.ILL_CONDITIONED


# ---------------------------------------------------------------- statistics


def test_attacks_are_estimated_with_the_deviation_that_is_stated() -> None:
    plant, rng, squares = scalar_plant(6, 9), np.random.default_rng(6), []
    for _ in range(20):
        _, y, _ = simulate(plant, 60, rng)
        sizes = rng.choice([-1.0, 1.0], (60, 9)) * rng.uniform(15, 40)
        lies = np.where(changing(rng, 60, 9, 3), sizes, 0.0)
        run = InnovationMixture(plant).run(y + lies)
        found = run.suspected & (lies != 0)
        assert found.sum() > 0.99 * (lies != 0).sum()
        squares.append((((run.attack - lies) / run.attack_std) ** 2)[found])
        assert np.isnan(run.attack_std[~run.suspected]).all() and (run.attack[~run.suspected] == 0).all()
    mean = np.concatenate(squares).mean()
    assert 0.92 < mean < 1.08, mean


def errors(attack: str, plants: int, T: int = 120) -> tuple[float, float, float]:
    """MSE of the mixture over the oracle's, NEES, and the share of honest readings suspected."""
    ours, best, nees, alarms = [], [], [], []
    for seed in range(plants):
        rng = np.random.default_rng([seed, 77])
        plant = scalar_plant(seed)
        x, y, _ = simulate(plant, T, rng)
        lies = changing(rng, T, 15, 6) if attack == "changing" else np.zeros((T, 15), dtype=bool)
        y = np.where(lies, y + rng.uniform(-10, 10, y.shape) + 3 * rng.normal(size=y.shape), y)
        run = InnovationMixture(plant).run(y)
        assert run.P is not None
        ours.append(((run.x - x) ** 2).mean())
        best.append(((OracleFilter(plant).run(y, attacked=lies).x - x) ** 2).mean())
        nees.append(((run.x - x) ** 2 / run.P[..., 0]).mean())
        alarms.append(run.suspected[~lies].mean())
    return float(np.mean(ours) / np.mean(best)), float(np.mean(nees)), float(np.mean(alarms))


def test_it_costs_little_while_nobody_lies() -> None:
    ratio, nees, alarms = errors("nobody", 60)
    assert ratio < 1.09 and 0.8 < nees < 1.0 and 0.005 < alarms < 0.015


def test_it_stays_near_the_oracle_while_liars_change() -> None:
    ratio, nees, alarms = errors("changing", 40)
    assert ratio < 1.5 and nees < 1.3 and alarms < 0.04


def test_a_sensor_that_always_lies_is_doubted_sooner() -> None:
    plant = scalar_plant(8, 9)
    _, y, _ = simulate(plant, 120, np.random.default_rng(8))
    y[:, 0] = np.nan
    x = InnovationMixture(plant).run(y).innovation  # about the prediction that both runs make at the end
    late = y.copy()
    late[:100, 0] = 200.0
    late[100] = y[100] - x[100]
    late[100, 0] = late[100, 1] / plant.C[1, 0] * plant.C[0, 0] + 2.5 * np.sqrt(plant.R[0, 0])
    for memory in ("rate", "sticky"):
        known = InnovationMixture(plant, memory=memory).run(late)
        fresh = late.copy()
        fresh[:100, 0] = np.nan
        unknown = InnovationMixture(plant, memory=memory).run(fresh)
        assert known.trust[100, 0] < unknown.trust[100, 0] - 0.2, memory


def test_a_liar_that_stops_is_soon_believed_again() -> None:
    honest_again = []
    for seed in range(10):
        plant, T = scalar_plant(seed, 6), 300
        _, y, _ = simulate(plant, T, np.random.default_rng(seed))
        y[50:150, 0] += 8 * np.sqrt(plant.R[0, 0])
        honest_again.append(
            [InnovationMixture(plant, memory=m).run(y).suspected[150:, 0].mean() for m in ("rate", "doubt")]
        )
    rate, doubt = np.mean(honest_again, axis=0)
    assert rate < 0.15 < 2 * rate < doubt


def test_the_monitor_finds_a_small_bias_and_hardly_accuses_the_honest() -> None:
    plant, rng = scalar_plant(9, 15), np.random.default_rng(9)
    _, y, _ = simulate(plant, 2000, rng)
    honest = InnovationMixture(plant, monitor=0.95).run(y)
    plain = InnovationMixture(plant).run(y)
    assert honest.suspected.mean() < plain.suspected.mean() + 1e-3
    y[:, 3] += np.sqrt(plant.R[3, 3])
    found = InnovationMixture(plant, monitor=0.95).run(y).suspected[200:, 3].mean()
    assert found > 0.6 > 0.2 > InnovationMixture(plant).run(y).suspected[200:, 3].mean()


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("form", "ep"),
        ("attacked", "normal"),
        ("memory", None),
        ("merge", 1),
        ("kappa", 0.0),
        ("kappa", float("nan")),
        ("forgetting", 1.0),
        ("monitor", 0),
        ("monitor_rate", "0.1"),
    ],
)
def test_settings_out_of_range_are_named(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=name) as refusal:
        InnovationMixture(scalar_plant(0, 3), **{name: value})
    assert repr(value) in str(refusal.value)


def test_sensors_that_share_noise_are_refused_by_name() -> None:
    R = np.eye(3) + 0.2
    sensors = [Sensor(name, C=[1.0]) for name in "abc"]
    with pytest.raises(DesignError, match="'a' and 'b'"):
        InnovationMixture(Plant([[0.9]], [[1.0]], sensors, R=R))


def test_without_a_steady_state_a_prior_is_asked_for() -> None:
    plant = random_plant(1, varying=30)
    y, u = attacked_run(plant, 1, 30)
    estimator = InnovationMixture(plant)
    assert estimator.no_steady_state
    with pytest.raises(InputError, match="prior"):
        estimator.run(y, u)
    assert np.isfinite(estimator.run(y, u, some_prior(plant)).x).all()
