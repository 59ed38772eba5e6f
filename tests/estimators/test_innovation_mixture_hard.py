"""No data, however hard, makes the innovation mixture fail. SECURESTATE_FUZZ is the number of samples."""

import os
from typing import Any

import numpy as np
import pytest

from securestate import Belief, InnovationMixture, KalmanFilter, Plant, Sensor
from tests.estimators.mixture_cases import Array, heard

SAMPLES = int(os.environ.get("SECURESTATE_FUZZ", "100000"))
T = 500


def hostile_plant(rng: np.random.Generator) -> Plant:
    """Noise over twelve decades, sensors that are the same, Q maybe singular."""
    n, N = int(rng.integers(1, 7)), int(rng.integers(1, 9))
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.3, 0.999) / np.abs(np.linalg.eigvals(A)).max()
    root = rng.normal(size=(n, int(rng.integers(1, n + 1))))
    sensors: list[Sensor] = []
    for i in range(N):
        if sensors and rng.random() < 0.2:
            twin = sensors[int(rng.integers(len(sensors)))]
            sensors.append(Sensor(f"s{i}", C=twin.C, R=twin.R))
            continue
        m = int(rng.integers(1, 4))
        noise = rng.normal(size=(m, m))
        R = 10.0 ** rng.uniform(-6, 6) * (noise @ noise.T + 0.1 * np.eye(m))
        sensors.append(Sensor(f"s{i}", C=rng.normal(size=(m, n)), R=R, protected=bool(rng.random() < 0.1)))
    return Plant(A, root @ root.T, sensors)


def hostile_data(plant: Plant, rng: np.random.Generator) -> Array:
    """Sane readings, wild ones up to 1e300, samples in which everybody lies or nobody speaks."""
    free = ~plant.protected[plant.channel_sensor]
    y = rng.normal(size=(T, plant.m)) * 10.0 ** rng.uniform(-3, 3, size=(T, 1))
    wild = ((rng.random(y.shape) < 0.05) | (rng.random((T, 1)) < 0.05)) & free
    y[wild] = rng.choice([-1.0, 1.0], wild.sum()) * 10.0 ** rng.uniform(0, 300, wild.sum())
    y[rng.random(T) < 0.02] = 0.0
    y[(rng.random(y.shape) < 0.1) | (rng.random((T, 1)) < 0.03)] = np.nan
    return y


def some_settings(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "form": str(rng.choice(["propagation", "belief"])),
        "attacked": str(rng.choice(["learned", "student"])),
        "memory": str(rng.choice(["rate", "doubt", "sticky"])),
        "merge": bool(rng.random() < 0.7),
        "kappa": 10.0 ** rng.uniform(-3, 9),
        "forgetting": float(rng.uniform(0.01, 0.999)),
        "monitor": None if rng.random() < 0.5 else float(rng.uniform(0.01, 0.99)),
        "monitor_rate": 10.0 ** rng.uniform(-8, -0.1),
    }


def check(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant, settings = hostile_plant(rng), some_settings(rng)
    y, prior = (
        hostile_data(plant, rng),
        Belief(np.zeros(plant.n), 10.0 ** rng.uniform(-6, 9) * np.eye(plant.n)),
    )
    run, where = InnovationMixture(plant, **settings).run(y, prior=prior), f"seed {seed}: {settings}"
    sent, spoke = ~np.isnan(y), heard(plant, y)
    assert run.P is not None
    for values in (run.x, run.x_std, run.P, run.trust[spoke], run.attack[sent]):
        assert not np.isnan(values).any(), where
    assert (np.linalg.eigvalsh(run.P) >= -1e-9 * np.abs(run.P).max(axis=(1, 2))[:, None]).all(), where
    assert np.isnan(run.trust[~spoke]).all() and not run.suspected[~spoke].any(), where
    assert ((run.trust[spoke] >= 0) & (run.trust[spoke] <= 1)).all(), where
    np.testing.assert_array_equal(run.suspected[spoke], run.trust[spoke] < 0.5)
    assert not run.suspected[:, plant.protected].any(), where


def test_no_plant_no_setting_and_no_reading_leads_to_nan_or_an_exception() -> None:
    for seed in range(max(1, SAMPLES // T)):
        check(seed)


@pytest.mark.parametrize(
    ("ratio", "tolerance"), [(1.0, 1e-12), (1e4, 1e-9), (1e8, 1e-5), (1e14, None), (1e20, None)]
)
@pytest.mark.parametrize("protected", [True, False])
def test_a_prior_far_larger_than_the_noise_costs_digits_and_never_leads_to_nan(
    ratio: float, tolerance: float | None, protected: bool
) -> None:
    for seed in range(30):
        rng = np.random.default_rng(seed)
        C = [rng.normal(size=(1 + i % 2, 4)) for i in range(6)]
        sensors = [
            Sensor(f"s{i}", C=c, R=1e-6 * np.eye(len(c)), protected=protected) for i, c in enumerate(C)
        ]
        plant, prior = (
            Plant(0.5 * np.eye(4), np.eye(4), sensors),
            Belief(np.zeros(4), 1e-6 * ratio * np.eye(4)),
        )
        x = rng.normal(size=4) * np.sqrt(1e-6 * ratio)
        y = np.stack([plant.C @ x, 0.5 * plant.C @ x])
        y[0, 2:] = np.nan  # two channels, four states
        run = InnovationMixture(plant).run(y, prior=prior)
        assert np.isfinite(run.x).all() and np.isfinite(run.x_std).all()
        if protected and tolerance is not None:
            kalman = KalmanFilter(plant).run(y, prior=prior)
            assert (np.abs(run.x - kalman.x) <= tolerance * kalman.x_std).all()
