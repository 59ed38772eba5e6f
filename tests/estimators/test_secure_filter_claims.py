"""The secure filter under attack: who is named, how well state and lies are known, how often in vain."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benches import secure_fuzz
from benches.cold_start import instance
from securestate import (
    Belief,
    KalmanFilter,
    OracleFilter,
    Plant,
    Run,
    SecureFilter,
    SecurestateWarning,
    Sensor,
    Status,
    cold_start,
)
from tests.estimators.mixture_cases import Array, mean_square, scalar_plant, simulate

GOLDEN = json.loads((Path(__file__).parents[1] / "cases/secure-filter/golden.json").read_text())
Liars = NDArray[np.bool_]
CLEAN = 30


def batch(plant: Plant, runs: int, T: int, seed: int) -> tuple[Array, Array]:
    """States (runs, T, n) and readings (runs, T, m) of a plant without inputs, while nobody lies."""
    rng = np.random.default_rng(seed)
    x, y = np.zeros((runs, T, plant.n)), np.empty((runs, T, plant.m))
    root_Q, root_R = np.linalg.cholesky(plant.Q + 1e-15 * np.eye(plant.n)), np.linalg.cholesky(plant.R)
    state = np.zeros((runs, plant.n))
    for k in range(T):
        x[:, k] = state
        y[:, k] = state @ plant.C.T + rng.normal(size=(runs, plant.m)) @ root_R.T
        state = state @ plant.A.T + rng.normal(size=(runs, plant.n)) @ root_Q.T
    return x, y


def axes_plant() -> Plant:
    """Position and speed along two axes; eight sensors see one position, seven the other."""
    block, g = 0.931 * np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([[0.125], [0.5]])
    sensors = [Sensor(f"s{i}", C=(1 + i / 14) * np.eye(4)[2 * (i % 2)], R=1 + (i % 4) / 3) for i in range(15)]
    return Plant(np.kron(np.eye(2), block), np.kron(np.eye(2), g @ g.T + 0.01 * np.eye(2)), sensors)


def oracle(plant: Plant, y: Array, liars: Liars) -> Run:
    return OracleFilter(plant).run(y, attacked=liars)


def lying(plant: Plant, y: Array, sensors: list[int], *, after: int = CLEAN) -> Liars:
    """Who lies: these sensors from a sample on."""
    liars = np.zeros((*y.shape[:-1], plant.n_sensors), dtype=bool)
    liars[..., after:, sensors] = True
    return liars


# ---------------------------------------------------------------- attacks


@pytest.mark.parametrize("size", [5.0, 20.0, -1e4])
def test_a_constant_injection_is_named_measured_and_its_sensor_is_used_again(size: float) -> None:
    plant, liars = scalar_plant(5), [0, 3]
    x, y = batch(plant, 300, CLEAN + 150, 1)
    y[:, CLEAN:, liars] += size
    run, told = SecureFilter(plant).run(y), oracle(plant, y, lying(plant, y, liars))
    late = CLEAN + 30
    assert run.suspected[:, late:, liars].mean() > 0.99
    z = ((run.attack - size) / run.attack_std)[:, late:, liars][run.suspected[:, late:, liars]]
    assert np.abs(z).max() < 6 and (np.abs(z) < 4).mean() > 0.999 and (z**2).mean() < 1.5
    assert mean_square(run, x, late) < 0.95 * mean_square(told, x, late)


def attack(kind: str, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """What a liar adds, (runs, T)."""
    k = np.arange(shape[1])
    return {
        "ramp": np.broadcast_to(0.2 * k, shape),
        "noise": 10 * rng.normal(size=shape),
        "square": np.broadcast_to(np.where(k // 10 % 2 == 0, 12.0, 0.0), shape),
        "sine": np.broadcast_to(10 * np.sin(k / 5), shape),
    }[kind]


@pytest.mark.parametrize(("kind", "bound"), [("ramp", 1.4), ("noise", 1.3), ("square", 1.2), ("sine", 1.4)])
def test_liars_of_any_kind_cost_little_more_than_knowing_them(kind: str, bound: float) -> None:
    plant, liars = scalar_plant(9), [0, 4, 5]
    x, y = batch(plant, 200, CLEAN + 100, 2)
    rng, told = np.random.default_rng(3), lying(plant, y, liars)
    for i in liars:
        y[:, CLEAN:, i] += attack(kind, (200, 100), rng)
    run, best = SecureFilter(plant).run(y), oracle(plant, y, told)
    ratio = mean_square(run, x, CLEAN) / mean_square(best, x, CLEAN)
    plain = mean_square(KalmanFilter(plant).run(y), x, CLEAN) / mean_square(best, x, CLEAN)
    assert ratio < bound < plain, (ratio, plain)


def test_who_stops_lying_is_trusted_again() -> None:
    plant = scalar_plant(7)
    _, y = batch(plant, 100, 200, 4)
    y[:, 30:100, 0] += 15.0
    run = SecureFilter(plant).run(y)
    assert run.suspected[:, 40:100, 0].all()
    assert run.suspected[:, 110:, 0].mean() < 0.05 and (run.trust[:, 130:, 0] > 0.5).mean() > 0.97
    assert (run.attack[:, 110:, 0][~run.suspected[:, 110:, 0]] == 0).all()


def test_liars_drawn_anew_at_every_sample() -> None:
    plant, rng = scalar_plant(15), np.random.default_rng(5)
    x, y = batch(plant, 150, CLEAN + 100, 5)
    liars = rng.random((150, CLEAN + 100, 15)).argsort(axis=-1) < 5
    liars[:, :CLEAN] = False
    y = y + liars * rng.choice([-12.0, 12.0], y.shape)
    run, best = SecureFilter(plant).run(y), oracle(plant, y, liars)
    assert mean_square(run, x, CLEAN) < 1.25 * mean_square(best, x, CLEAN)
    assert run.suspected[liars].mean() > 0.97 and run.suspected[~liars].mean() < 0.04


def test_a_protected_sensor_is_believed_and_shifts_the_blame() -> None:
    guarded = [Sensor(f"s{i}", C=[1.0], R=1.0, protected=i == 0) for i in range(5)]
    plant = Plant([[0.9]], [[1.0]], guarded)
    x, y = batch(plant, 100, CLEAN + 60, 6)
    y[:, CLEAN:, 1:] += 8.0  # all but the protected one agree
    run = SecureFilter(plant).run(y)
    late = CLEAN + 10
    assert (run.trust[..., 0] == 1).all() and not run.suspected[..., 0].any()
    assert run.suspected[:, late:, 1:].mean() > 0.95
    told = oracle(plant, y, lying(plant, y, [1, 2, 3, 4]))
    assert mean_square(run, x, late) < 1.1 * mean_square(told, x, late)


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
def test_an_unstable_plant_is_followed() -> None:
    sensors = [Sensor(f"s{i}", C=[1.0, 0.3 * i], R=1.0) for i in range(7)]
    plant = Plant([[1.03, 0.1], [0.0, 0.98]], 0.1 * np.eye(2), sensors)
    x, y = batch(plant, 50, CLEAN + 120, 7)
    y[:, CLEAN:, 2] += 0.5 * x[:, CLEAN:, 0]
    y[:, CLEAN:, 5] -= 9.0
    run, best = SecureFilter(plant).run(y), oracle(plant, y, lying(plant, y, [2, 5]))
    assert mean_square(run, x, CLEAN) < 1.6 * mean_square(best, x, CLEAN)
    assert np.isfinite(run.x_std).all()


def test_a_frozen_minority_of_those_who_see_one_axis_does_not_lock_the_filter() -> None:
    plant, liars = axes_plant(), [0, 1, 2]
    x, y = batch(plant, 40, CLEAN + 200, 8)
    y[:, CLEAN:, liars] = y[:, CLEAN : CLEAN + 1, liars]
    run, best = SecureFilter(plant).run(y), oracle(plant, y, lying(plant, y, liars))
    late = CLEAN + 100
    assert mean_square(run, x, late) < 1.5 * mean_square(best, x, late)


# ---------------------------------------------------------------- false alarms


@pytest.mark.parametrize(("rate", "steps"), [(1e-3, 200_000), (1e-2, 30_000)])
@pytest.mark.parametrize("kind", ["scalar", "axes"])
def test_honest_sensors_are_suspected_as_often_as_asked(kind: str, rate: float, steps: int) -> None:
    plant = scalar_plant(15) if kind == "scalar" else axes_plant()
    _, y = batch(plant, 50, steps // 50, 9)
    run = SecureFilter(plant, false_alarm_rate=rate).run(y, covariance=False)
    assert rate / 1.5 < run.suspected.mean() < 1.5 * rate, run.suspected.mean()


def two_channels() -> Plant:
    """Five sensors that each see two combinations of the four states of the plane."""
    rows = np.random.default_rng(3).normal(size=(5, 2, 4))
    plane = axes_plant()
    return Plant(plane.A, plane.Q, [Sensor(f"s{i}", C=row, R=np.eye(2)) for i, row in enumerate(rows)])


def each_alone() -> Plant:
    """Four states that have nothing to do with each other, each seen by one sensor."""
    return Plant(
        np.diag([0.9, 0.8, 0.5, 0.95]), np.eye(4), [Sensor(f"s{i}", C=np.eye(4)[i], R=1.0) for i in range(4)]
    )


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
@pytest.mark.parametrize(("design", "low", "high"), [(two_channels, 0.3, 1.0), (each_alone, 1.0, 4.0)])
def test_sensors_with_two_channels_are_suspected_less_often_and_those_nobody_vouches_for_more(
    design: Callable[[], Plant], low: float, high: float
) -> None:
    """As docs/secure-filter.md says."""
    _, y = batch(design(), 50, 3000, 9)
    run = SecureFilter(design(), false_alarm_rate=1e-3).run(y, covariance=False)
    assert low < run.suspected.mean() / 1e-3 < high, run.suspected.mean()


# ---------------------------------------------------------------- records of another program


@pytest.mark.parametrize("case", GOLDEN, ids=lambda case: case["name"])
def test_its_error_is_no_worse_than_that_of_an_independent_program(case: dict[str, Any]) -> None:
    protected = case["protected"] or [False] * len(case["C"])
    sensors = [
        Sensor(f"s{i}", C=C, R=R, protected=told)
        for i, (C, R, told) in enumerate(zip(case["C"], case["R"], protected, strict=True))
    ]
    plant = Plant(case["A"], case["Q"], sensors, B=np.eye(len(case["A"])))
    y = np.array(case["y"], dtype=float)
    prior = Belief(case["x0"], case["P0"])
    run = SecureFilter(plant, false_alarm_rate=case["alpha"]).run(y.reshape(len(y), -1), case["u"], prior)
    ours, theirs = (((x - np.array(case["truth"])) ** 2).sum(axis=1).mean() for x in (run.x, case["x"]))
    assert ours < 1.1 * theirs


# ---------------------------------------------------------------- no prior


@pytest.mark.parametrize("size", [(20, 20, 6), (20, 40, 12), (50, 50, 15)], ids=str)
def test_without_a_prior_fixed_liars_are_known_from_the_first_sample(size: tuple[int, int, int]) -> None:
    ratios = []
    for seed in range(5):
        one = instance(*size, seed, fixed=True)
        run = SecureFilter(one.plant).run(one.y, prior="window")
        tau = cold_start(one.plant, one.y).samples
        assert 0 < tau < len(one.y) and (run.status[:tau] == Status.COLD_START).all()
        np.testing.assert_array_equal(run.suspected[:tau], one.liars[:tau])
        assert (run.suspected[tau:] == one.liars[tau:]).mean() > 0.97
        vague = Belief(np.zeros(size[0]), 100 * np.eye(size[0]))
        best = OracleFilter(one.plant).run(one.y, prior=vague, attacked=one.liars)
        error, least = (((each.x - one.x[:-1])[tau:] ** 2).mean() for each in (run, best))
        ratios.append(error / least)
    assert np.median(ratios) < 1.2 and max(ratios) < 1.5, ratios


def test_a_start_that_is_not_certified_warns_and_says_so() -> None:
    plant = scalar_plant(5)
    _, y = batch(plant, 1, 30, 11)
    y[0, :, :3] += np.array([50.0, -70.0, 90.0]) * np.arange(30)[:, np.newaxis]
    with pytest.warns(SecurestateWarning, match="not certified"):
        run = SecureFilter(plant).run(y[0], prior="window")
    assert run.status[0] == Status.ILL_CONDITIONED and np.isfinite(run.x).all()


# ---------------------------------------------------------------- numbers at their limits


def test_no_plant_and_no_reading_breaks_a_promise() -> None:
    for seed in range(2000 // secure_fuzz.T):
        assert not secure_fuzz.check(seed)[0]


@pytest.mark.parametrize("size", [1e8, 1e100, 1e300])
def test_a_reading_beyond_all_bounds_counts_as_nothing(size: float) -> None:
    plant = scalar_plant(9)
    x, y, _ = simulate(plant, 60, np.random.default_rng(5))
    y[:, 0], y[::7, 1] = size, -size
    liars = np.abs(y) > 1e7
    run, told = SecureFilter(plant).run(y), oracle(plant, y, liars)
    assert run.suspected[liars].all() and run.suspected[~liars].mean() < 0.05
    np.testing.assert_allclose(run.attack[liars], y[liars], rtol=1e-3)
    assert mean_square(run, x) < 1.5 * mean_square(told, x)


def test_noise_far_below_the_state_and_a_singular_q() -> None:
    rotation = np.array([[0.8, -0.6], [0.6, 0.8]])
    sensors = [Sensor(f"s{i}", C=[np.cos(i), np.sin(i)], R=1e-12) for i in range(7)]
    plant = Plant(rotation, np.diag([1e-4, 0.0]), sensors)
    x, y = batch(plant, 20, 80, 12)
    y[:, 20:, 3] += 1e-3
    run = SecureFilter(plant).run(y, prior=Belief([0.0, 0.0], 1e-4 * np.eye(2)))
    assert run.suspected[:, 20:, 3].all() and np.delete(run.suspected, 3, axis=2).mean() < 0.01
    assert np.abs((run.x - x) / run.x_std).max() < 6 and np.isfinite(run.x_std).all()


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
@pytest.mark.parametrize("N", [1, 2])
def test_one_or_two_sensors_are_followed_while_honest(N: int) -> None:
    plant = scalar_plant(N)
    x, y = batch(plant, 50, 200, 13)
    run, best = SecureFilter(plant).run(y), KalmanFilter(plant).run(y)
    assert mean_square(run, x) < 1.05 * mean_square(best, x)
