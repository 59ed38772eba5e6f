"""The oracle: the Kalman filter that is told who is attacked."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from securestate import (
    InputError,
    KalmanFilter,
    MeasurementError,
    OracleFilter,
    Plant,
    Sensor,
    ShapeError,
)
from tests.estimators.kalman_cases import random_data, random_plant, some_prior
from tests.reference.detectors import detect

CASE = json.loads((Path(__file__).parents[1] / "cases/detectors/scalar.json").read_text())


def test_golden_run() -> None:
    A, Q, C, R = (CASE["system"][name] for name in "AQCR")
    sensors = [Sensor(f"s{i}", C=[c], R=r) for i, (c, r) in enumerate(zip(C, R, strict=True))]
    plant, y = Plant([[A]], [[Q]], sensors), np.array(CASE["y"])
    for golden, run in {
        "oracle": OracleFilter(plant).run(y, attacked=np.array(CASE["attacked"])),
        "plain": KalmanFilter(plant).run(y),
    }.items():
        assert run.P is not None
        np.testing.assert_allclose(run.x[:, 0], CASE["runs"][golden]["x"], atol=1e-8)
        np.testing.assert_allclose(run.P[:, 0, 0], CASE["runs"][golden]["P"], atol=1e-8)


def engineering(plant: Plant) -> Plant:
    """The same plant in other units."""
    sensors = [Sensor(s.name, C=s.C, offset=3.0 + i, scale=0.5 + i) for i, s in enumerate(plant.sensors)]
    units: dict[str, Any] = {"input_offset": [5.0, -3.0], "input_scale": [2.0, 0.5]}
    return Plant(plant.A, plant.Q, sensors, B=plant.B, D=plant.D, R=plant.R, **units)


@pytest.mark.parametrize("seed", range(3))
def test_equals_the_textbook_that_never_hears_the_attacked(seed: int) -> None:
    plain = random_plant(seed)
    plant, prior = engineering(plain), some_prior(plain)
    assert prior.P is not None
    y, u = random_data(plain, 80, seed, missing=0.2)
    attacked = np.random.default_rng(seed).random((80, 3)) < 0.3
    expected = detect(plain, lambda k, *_: attacked[k], y, u, prior.x, prior.P)
    file_u = plant.input_offset + plant.input_scale * u
    run = OracleFilter(plant).run(plant.denormalise(y), file_u, prior, attacked=attacked)
    np.testing.assert_allclose(run.x, expected.x, atol=1e-9)
    np.testing.assert_allclose(run.P, expected.P, atol=1e-9)
    np.testing.assert_array_equal(run.suspected, expected.left_out)
    np.testing.assert_allclose(run.attack, plant.scale * expected.attack, atol=1e-8)
    np.testing.assert_array_equal(np.isnan(run.trust), np.isnan(y).reshape(80, 3, 2).all(axis=2))
    np.testing.assert_array_equal(run.trust == 0, expected.left_out)
    predicted = np.vstack([prior.x, expected.x[:-1] @ plain.A.T + u[:-1] @ plain.B.T])
    innovation = plant.scale * (y - predicted @ plain.C.T - u @ plain.D.T)
    np.testing.assert_allclose(run.innovation, innovation, atol=1e-8)
    assert run.estimator == "OracleFilter"


def test_is_the_kalman_filter_when_nobody_is_attacked() -> None:
    plant = random_plant(1)
    y, u = random_data(plant, 50, 1, missing=0.1)
    run, kalman = (
        OracleFilter(plant).run(y, u, attacked=np.zeros(3, dtype=bool)),
        KalmanFilter(plant).run(y, u),
    )
    for name in ("x", "P", "trust", "innovation", "innovation_std", "status", "suspected"):
        np.testing.assert_array_equal(getattr(run, name), getattr(kalman, name))


def test_a_step_at_a_time_gives_the_same_as_a_run() -> None:
    plain = random_plant(4)
    T, rng = 40, np.random.default_rng(4)
    sensors = [Sensor(f"s{i}", C=plain.C[2 * i : 2 * i + 2] + rng.normal(size=(T, 2, 4))) for i in range(3)]
    varied = Plant(np.repeat(plain.A[None], T, 0), plain.Q, sensors, B=plain.B, D=plain.D, R=plain.R)
    y, u = random_data(plain, T, 4, missing=0.1)
    attacked, prior = rng.random((T, 3)) < 0.3, some_prior(plain)
    for plant in (plain, varied):
        oracle = OracleFilter(plant)
        run, live = oracle.run(y, u, prior, attacked=attacked), oracle.start(prior)
        steps = [live.step(y[k], u[k], attacked=attacked[k]) for k in range(T)]
        for name in ("x", "x_std", "P", "trust", "suspected", "innovation_std", "status"):
            np.testing.assert_array_equal([getattr(step, name) for step in steps], getattr(run, name))
        for name in ("attack", "innovation"):
            np.testing.assert_allclose(
                [getattr(step, name) for step in steps], getattr(run, name), atol=1e-12
            )
        assert [step.diagnostics["nis"] for step in steps] == list(run.diagnostics["nis"])
    with pytest.raises(MeasurementError, match="at most 40 samples"):
        live.step(y[0], u[0], attacked=attacked[0])


@pytest.mark.parametrize("shape", [(3,), (20, 3), (2, 20, 3)])
def test_the_attacked_set_may_be_given_once_per_sample_or_per_run(shape: tuple[int, ...]) -> None:
    plant = random_plant(2)
    pairs = [random_data(plant, 20, seed) for seed in range(2)]
    y, u = np.stack([pair[0] for pair in pairs]), pairs[0][1]
    attacked = np.random.default_rng(0).random(shape) < 0.4
    batch = OracleFilter(plant).run(y, u, attacked=attacked)
    whole = np.broadcast_to(attacked, (2, 20, 3))
    np.testing.assert_array_equal(batch.suspected, whole)
    for r in range(2):
        single = OracleFilter(plant).run(y[r], u, attacked=whole[r])
        for name in ("x", "P", "trust", "attack", "innovation"):
            np.testing.assert_array_equal(getattr(batch, name)[r], getattr(single, name))


def test_a_wrong_attacked_set_is_refused() -> None:
    plant = random_plant(2)
    y, u = random_data(plant, 5, 2)
    oracle = OracleFilter(plant)
    with pytest.raises(InputError, match="attacked: expected an array of booleans, received dtype int64"):
        oracle.run(y, u, attacked=np.array([0, 1, 0]))
    for shape in [(2,), (4, 3), (1, 5, 3), ()]:
        with pytest.raises(ShapeError, match=r"attacked: expected shape \(3,\) or shape \(5, 3\), received"):
            oracle.run(y, u, attacked=np.zeros(shape, dtype=bool))
    with pytest.raises(InputError, match="plant: expected a Plant"):
        OracleFilter("plant.toml")  # type: ignore[arg-type]
