"""Plants and checks for the estimators that take injections for states."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.linalg import block_diag

from securestate import Belief, Estimator, Plant, Run, Sensor
from tests.estimators.kalman_cases import Array, random_plant
from tests.estimators.run_arrays import RUN_ARRAYS
from tests.reference.attack_as_state import System, Textbook

ROOT = Path(__file__).parents[2]
PUBLISHED = json.loads((ROOT / "tests/cases/attack-as-state/four_bus.json").read_text())


def weak_plant(seed: int, **options: Any) -> Plant:
    """Two weak sensors of two channels, a protected one, inputs, correlated noise, channels with units."""
    plant = random_plant(seed, **options)
    sensors = [
        Sensor(sensor.name, C=sensor.C, protected=i == 2, scale=[2.0, 0.5], offset=[1.0, -3.0])
        for i, sensor in enumerate(plant.sensors)
    ]
    return Plant(plant.A, plant.Q, sensors, B=plant.B, D=plant.D, R=plant.R)


def varying_plant(seed: int, T: int) -> Plant:
    plant, rng = weak_plant(seed), np.random.default_rng(seed)
    A, C = plant.A + 0.05 * rng.normal(size=(T, 4, 4)), plant.C + 0.5 * rng.normal(size=(T, 6, 4))
    sensors = [
        Sensor(s.name, C=C[:, 2 * i : 2 * i + 2], protected=s.protected, scale=s.scale, offset=s.offset)
        for i, s in enumerate(plant.sensors)
    ]
    return Plant(A, plant.Q, sensors, B=plant.B, D=plant.D, R=plant.R)


def attacked_data(plant: Plant, T: int, seed: int, *, missing: float = 0.0) -> tuple[Array, Array]:
    """What the plant's sensors send in file units while the weak ones drift, channels missing."""
    rng = np.random.default_rng(seed)
    y, u = 3 * rng.normal(size=(T, plant.m)), rng.normal(size=(T, plant.n_inputs))
    y[:, 0] += 0.1 * np.arange(T)
    y[T // 2 :, 3] += 9.0
    y[rng.random(y.shape) < missing] = np.nan
    y[T // 3] = np.nan if missing else y[T // 3]
    return plant.denormalise(y), u


def begin(plant: Plant, prior: Belief, theta: Array) -> tuple[Array, Array]:
    """X and P before the first sample."""
    assert prior.P is not None
    return np.concatenate([prior.x, np.zeros(len(theta))]), block_diag(prior.P, np.diag(theta))


def assert_equals(run: Run, book: Textbook, s: System, rate: float, tolerance: float = 1e-8) -> None:
    plant, n = run.plant, run.plant.n

    def close(mine: Array, theirs: Array) -> None:
        size = np.nanmax(np.abs(theirs), initial=1.0)
        np.testing.assert_allclose(mine, theirs, rtol=tolerance, atol=tolerance * size)

    assert run.P is not None
    close(run.x, book.X[:, :n])
    close(run.P, book.P[:, :n, :n])
    np.testing.assert_array_equal(run.x_std, np.sqrt(np.diagonal(run.P, axis1=1, axis2=2)))
    close(run.innovation, book.innovation * plant.scale)
    close(run.innovation_std, book.innovation_std * plant.scale)
    close(run.diagnostics["log_likelihood"], book.log_likelihood)
    close(run.diagnostics["nis"], book.nis)
    missing = np.isnan(run.innovation)
    theta, std = np.zeros_like(run.attack), np.zeros_like(run.attack)
    theta[:, s.weak] = book.X[:, n:]
    std[:, s.weak] = np.sqrt(np.diagonal(book.P, axis1=1, axis2=2)[:, n:])
    close(run.attack, np.where(missing, np.nan, theta * plant.scale))
    close(run.attack_std, np.where(missing, np.nan, std * plant.scale))
    close(run.trust, trust(run, book, s, rate))
    np.testing.assert_array_equal(run.suspected, run.trust < 0.5)


def trust(run: Run, book: Textbook, s: System, rate: float) -> Array:
    plant, out = run.plant, np.full(run.trust.shape, np.nan)
    for k, sensor in np.ndindex(*out.shape):
        own = [
            i
            for i in range(plant.m)
            if plant.channel_sensor[i] == sensor and not np.isnan(run.innovation[k, i])
        ]
        if own and plant.protected[sensor]:
            out[k, sensor] = 1.0
        elif own:
            at = plant.n + np.searchsorted(s.weak, own)
            theta, P = book.X[k, at], book.P[k][np.ix_(at, at)]
            out[k, sensor] = 1 / (1 + theta @ np.linalg.solve(P, theta) / stats.chi2.ppf(1 - rate, len(own)))
    return out


def assert_batch_is_loop_and_resumes(estimator: Estimator, prior: Belief | None, T: int = 150) -> None:
    data = [attacked_data(estimator.plant, T, seed, missing=0.1 * (seed % 2)) for seed in range(3)]
    batch = estimator.run(np.stack([y for y, _ in data]), np.stack([u for _, u in data]), prior)
    for r, (y, u) in enumerate(data):
        live, parts = estimator.start(prior), []
        for k in range(T):
            parts.append(live.step(y[k], u[k]))
            if k % 11 == 0:
                live = estimator.resume(live.save())
        for quantity in RUN_ARRAYS:
            mine = getattr(batch, quantity)[r]
            np.testing.assert_array_equal(mine, getattr(estimator.run(y, u, prior), quantity))
            np.testing.assert_array_equal(mine, [getattr(e, quantity) for e in parts])
        for name, values in batch.diagnostics.items():
            np.testing.assert_array_equal(values[r], [e.diagnostics[name] for e in parts])


def assert_numbers_stay_numbers(estimator: Estimator, prior: Belief | None) -> Run:
    """Outliers of 1e300, silence and everything between."""
    plant, rng = estimator.plant, np.random.default_rng(0)
    y, u = attacked_data(plant, 400, 0, missing=0.2)
    wild = rng.random(y.shape)
    y[wild < 0.05] = 1e300
    y[wild > 0.95] = -1e300
    y[100:200] = np.nan
    run = estimator.run(y, u, prior)
    sent = ~np.isnan(y)
    heard = np.stack([sent[:, plant.channels_of(i)].any(axis=1) for i in range(plant.n_sensors)], axis=1)
    assert run.P is not None
    for numbers in (run.x, run.x_std, run.P, run.innovation_std, run.attack[sent], run.attack_std[sent]):
        assert np.isfinite(numbers).all()
    assert np.isfinite(run.innovation[sent]).all()
    np.testing.assert_array_equal(np.isnan(run.trust), ~heard)
    assert not any(np.isnan(values).any() for values in run.diagnostics.values())
    return run


def four_bus_runs(
    runs: int, seed: int, steps: int = 100, variance: float = 5.0
) -> tuple[Plant, Belief, Array, Array]:
    """Weak 1, protected 3 and 4 of the example, theta_1 white: prior, x and y of k = 1, 2, ..."""
    plant = Plant.load(ROOT / "examples/four-bus/plant.toml").select([0, 2, 3])
    rng = np.random.default_rng(seed)
    state, x = rng.normal(size=(runs, 4)), np.empty((runs, steps, 4))
    for k in range(steps):
        state = state @ plant.A.T + rng.normal(size=(runs, 4)) * np.sqrt(np.diag(plant.Q))
        x[:, k] = state
    y = x @ plant.C.T + rng.normal(size=(runs, steps, 3)) * np.sqrt(np.diag(plant.R))
    y[..., 0] += np.sqrt(variance) * rng.normal(size=(runs, steps))
    return plant, Belief(np.zeros(4), plant.A @ plant.A.T + plant.Q), x, y


def assert_published(
    estimator: Estimator, row: dict[str, float], data: tuple[Plant, Belief, Array, Array]
) -> None:
    _, prior, x, y = data
    errors = ((estimator.run(y, prior=prior, covariance=False).x - x) ** 2).sum(axis=2).mean(axis=1)
    spread = np.hypot(errors.std(ddof=1) / np.sqrt(len(errors)), row["sd"] / np.sqrt(PUBLISHED["seeds"]))
    print(f"{row}: {errors.mean():.4f} +- {spread:.4f}")
    assert abs(errors.mean() - row["mse"]) <= 3 * spread
