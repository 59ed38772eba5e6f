"""The secure filter: nobody lies, what must not matter, and what a run promises."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import (
    InputError,
    KalmanFilter,
    MeasurementError,
    Plant,
    ResumeError,
    Run,
    SecureFilter,
    Sensor,
)
from tests.estimators.mixture_cases import (
    attacked_data,
    mean_square,
    random_plant,
    scalar_plant,
    simulate,
    some_prior,
    steps,
)
from tests.estimators.run_arrays import RUN_ARRAYS

Order = NDArray[np.intp]


def assert_same_bits(one: Run, other: Run, rows: slice = slice(None)) -> None:
    for name in RUN_ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name)[rows], err_msg=name)
    for name, values in one.diagnostics.items():
        np.testing.assert_array_equal(values, other.diagnostics[name][rows], err_msg=name)


def assert_close(one: Run, other: Run, order: Order | None = None, tolerance: float = 1e-8) -> None:
    """The same up to rounding; the sensors of `one` are those of `other` in `order`."""
    assert one.P is not None and other.P is not None
    scale = other.x_std.max()
    np.testing.assert_allclose(one.x, other.x, rtol=tolerance, atol=tolerance * scale)
    np.testing.assert_allclose(one.P, other.P, rtol=tolerance, atol=tolerance * scale**2)
    trust = other.trust if order is None else other.trust[:, order]
    np.testing.assert_allclose(one.trust, trust, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(one.status, other.status)


# ---------------------------------------------------------------- nobody lies


@pytest.mark.parametrize("seed", range(3))
def test_it_costs_little_while_nobody_lies(seed: int) -> None:
    plant = random_plant(seed, 1 + 2 * seed, channels=(1,) * 9, protected=())
    prior, rng = some_prior(plant), np.random.default_rng(seed)
    drawn = [simulate(plant, 150, rng, prior) for _ in range(40)]
    x, y, u = (np.stack(arrays) for arrays in zip(*drawn, strict=True))
    ours, best = SecureFilter(plant).run(y, u, prior), KalmanFilter(plant).run(y, u, prior)
    assert mean_square(ours, x) < 1.02 * mean_square(best, x)


def test_with_protected_sensors_only_it_is_the_kalman_filter() -> None:
    plant = random_plant(5, protected=tuple(f"s{i}" for i in range(7)))
    y, u = attacked_data(plant, 60, 5, missing=0.1)
    ours, book = SecureFilter(plant).run(y, u), KalmanFilter(plant).run(y, u)
    np.testing.assert_allclose(ours.x, book.x, rtol=0, atol=1e-9)
    assert ours.P is not None and book.P is not None
    np.testing.assert_allclose(ours.P, book.P, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.innovation_std, book.innovation_std, rtol=1e-9)
    assert not ours.suspected.any() and (ours.trust[~np.isnan(ours.trust)] == 1).all()


# ---------------------------------------------------------------- what must not matter


@pytest.mark.parametrize("seed", range(4))
def test_neither_the_order_of_the_sensors_nor_the_units_matter(seed: int) -> None:
    plant = random_plant(seed, protected=("s6",) if seed % 2 else ())
    y, u = attacked_data(plant, 80, seed, missing=0.05)
    run = SecureFilter(plant).run(y, u)
    order = np.random.default_rng(seed).permutation(7)
    factor, given, columns = 10.0 ** np.arange(-3, 4), [], []
    for i in order:
        sensor, own = plant.sensors[i], plant.channels_of(i)
        f, rows = factor[i], np.arange(plant.m)[own]
        given.append(
            Sensor(
                sensor.name,
                C=f * sensor.C,
                R=f * f * plant.R[np.ix_(rows, rows)],
                D=f * plant.D[rows],
                scale=sensor.scale,
                offset=sensor.offset / f,
                protected=sensor.protected,
            )
        )
        columns.append(rows)
    turned = Plant(plant.A, plant.Q, given, B=plant.B)
    rows = np.concatenate(columns)
    z = plant.normalise(y)[:, rows] * factor[plant.channel_sensor[rows]]
    other = SecureFilter(turned).run(turned.denormalise(z), u)
    assert run.suspected.any()
    assert_close(other, run, order, 1e-6)


def test_a_turned_vector_sensor_is_the_same_sensor() -> None:
    rng = np.random.default_rng(2)
    T, _ = np.linalg.qr(rng.normal(size=(2, 2)))
    C = [rng.normal(size=(2, 3)) for _ in range(6)]
    sensors = [Sensor(f"s{i}", C=c, R=(1 + i) * np.eye(2)) for i, c in enumerate(C)]
    turned = [Sensor(f"s{i}", C=T @ c, R=(1 + i) * np.eye(2)) for i, c in enumerate(C)]
    A = 0.9 * np.linalg.qr(rng.normal(size=(3, 3)))[0]
    plant, other = (Plant(A, np.eye(3), each) for each in (sensors, turned))
    _, y, _ = simulate(plant, 100, np.random.default_rng(2))
    y[30:, 2:4] += np.array([20.0, -9.0])
    z = (y.reshape(100, 6, 2) @ T.T).reshape(100, 12)
    run, same = SecureFilter(plant).run(y), SecureFilter(other).run(z)
    assert run.suspected[30:, 1].all()
    assert_close(same, run, tolerance=1e-6)
    np.testing.assert_allclose(
        same.attack.reshape(100, 6, 2) @ T, run.attack.reshape(100, 6, 2), rtol=0, atol=1e-5
    )


def test_a_sensor_that_sends_nothing_is_no_sensor() -> None:
    plant = scalar_plant(17)
    y, _ = attacked_data(plant, 80, 3)
    y[:, 4] = np.nan
    others = np.delete(np.arange(17), 4)
    fewer = Plant(plant.A, plant.Q, [plant.sensors[i] for i in others])
    prior = some_prior(plant)
    run, less = SecureFilter(plant).run(y, prior=prior), SecureFilter(fewer).run(y[:, others], prior=prior)
    assert np.isnan(run.trust[:, 4]).all() and np.isnan(run.attack[:, 4]).all()
    np.testing.assert_allclose(less.x, run.x, rtol=0, atol=1e-10)
    np.testing.assert_allclose(less.trust, run.trust[:, others], rtol=0, atol=1e-10)


def test_a_liar_that_was_silent_for_long_is_found_again_at_once() -> None:
    plant = scalar_plant(9)
    x, y, _ = simulate(plant, 1500, np.random.default_rng(4))
    y[:, 0] += 12.0
    y[100:1400, 0] = np.nan
    run = SecureFilter(plant).run(y)
    assert run.suspected[1:100, 0].all() and run.suspected[1400:, 0].all()
    assert np.isnan(run.trust[100:1400, 0]).all() and not run.suspected[100:1400, 0].any()
    assert mean_square(run, x) < 0.2


def test_inputs_that_reach_the_sensors_directly_are_taken_out() -> None:
    plant = random_plant(6)
    y, u = attacked_data(plant, 60, 6)
    still = Plant(plant.A, plant.Q, [s.replaced(D=None) for s in plant.sensors], B=plant.B)
    run = SecureFilter(plant).run(y, u)
    other = SecureFilter(still).run(y - plant.scale * (u @ plant.D.T), u)
    np.testing.assert_allclose(run.x, other.x, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.trust, other.trust, rtol=0, atol=1e-8)


# ---------------------------------------------------------------- runs


@pytest.mark.parametrize("varying", [None, 90])
def test_a_live_filter_saved_and_resumed_in_an_attack_gives_the_bits_of_the_run(varying: int | None) -> None:
    plant = random_plant(7, 2, varying=varying)
    y, u = attacked_data(plant, 90, 7, missing=0.05)
    y[20:70, 0] += 30 * plant.scale[0]
    prior, estimator = some_prior(plant), SecureFilter(plant)
    run = estimator.run(y, u, prior)
    for k, one in enumerate(steps(estimator, y, u, prior)):
        for name in RUN_ARRAYS:
            np.testing.assert_array_equal(getattr(one, name), getattr(run, name)[k], err_msg=name)
    live = estimator.start(prior)
    live.run(y[:45], u[:45])
    assert_same_bits(estimator.resume(live.save()).run(y[45:], u[45:]), run, slice(45, None))


def test_what_was_saved_by_another_filter_is_refused() -> None:
    plant = scalar_plant(5)
    blob = SecureFilter(plant).start().save()
    for other in (
        SecureFilter(plant, false_alarm_rate=0.01),
        SecureFilter(scalar_plant(5, R=2.0)),
        SecureFilter(scalar_plant(6)),
        SecureFilter(scalar_plant(5, protected=True)),
        KalmanFilter(plant),
    ):
        with pytest.raises(ResumeError):
            other.resume(blob)
    for damaged in (blob[:-1], blob[:20], b"", blob[:-9] + bytes(9)):
        with pytest.raises(ResumeError):
            SecureFilter(plant).resume(damaged)


def test_a_batch_is_its_runs_to_the_bit() -> None:
    plant = random_plant(8)
    pairs = [attacked_data(plant, 60, seed, missing=0.05 * (seed % 2)) for seed in range(8)]
    y, u = (np.stack(arrays) for arrays in zip(*pairs, strict=True))
    batch = SecureFilter(plant).run(y, u)
    for i in range(len(y)):
        one = SecureFilter(plant).run(y[i], u[i])
        for name in RUN_ARRAYS:
            np.testing.assert_array_equal(getattr(batch, name)[i], getattr(one, name), err_msg=name)


BATCH = """
import hashlib
import numpy as np
from securestate import SecureFilter
from tests.estimators.mixture_cases import attacked_data, random_plant
plant = random_plant(8)
pairs = [attacked_data(plant, 50, seed) for seed in range(12)]
run = SecureFilter(plant).run(*(np.stack(arrays) for arrays in zip(*pairs)))
print(hashlib.sha256(run.x.tobytes() + run.P.tobytes() + run.trust.tobytes()).hexdigest())
"""


def test_the_number_of_threads_does_not_matter() -> None:
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", BATCH],
            cwd=Path(__file__).parents[2],
            env=os.environ | {"RAYON_NUM_THREADS": threads},
            stdout=subprocess.PIPE,
            text=True,
        )
        for threads in ("1", "2")
    ]
    one, two = (process.communicate()[0] for process in processes)
    assert one == two and len(one) == 65


def test_a_plant_that_varies_needs_a_prior_and_ends() -> None:
    plant = random_plant(9, 2, varying=40)
    y, u = attacked_data(plant, 40, 9)
    estimator = SecureFilter(plant)
    assert estimator.steady is None and estimator.no_steady_state
    with pytest.raises(InputError, match="prior"):
        estimator.run(y, u)
    run = estimator.run(y, u, some_prior(plant))
    assert run.suspected.any() and np.isfinite(run.x).all()
    with pytest.raises(MeasurementError, match="at most 40 samples"):
        estimator.run(np.concatenate([y, y[:1]]), np.concatenate([u, u[:1]]), some_prior(plant))


def test_matrices_that_repeat_are_the_constant_plant() -> None:
    plant = random_plant(10)
    y, u = attacked_data(plant, 50, 10, missing=0.05)
    varied = Plant(np.repeat(plant.A[None], 50, axis=0), plant.Q, plant.sensors, B=plant.B)
    prior = some_prior(plant)
    assert_close(SecureFilter(varied).run(y, u, prior), SecureFilter(plant).run(y, u, prior), tolerance=1e-9)
