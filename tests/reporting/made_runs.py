"""Runs made up for the report: white innovations, slow states, sensors that lie from a known sample on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from securestate.estimators.run import Run
from securestate.plant import Plant, Sensor

SHIFT = 12.0
"""What a liar adds, in file units."""


def made_plant(states: int, sensors: int, *, names: list[str] | None = None, dt: float = 180.0) -> Plant:
    """A plant of scalar sensors with units; the last sensor is protected."""
    rng = np.random.default_rng(1)
    owned = [
        Sensor(
            names[i] if names else f"XMEAS {i + 1}",
            rng.standard_normal((1, states)),
            0.5,
            offset=100.0 + i,
            scale=2.0,
            unit="kPa",
            protected=i == sensors - 1,
        )
        for i in range(sensors)
    ]
    return Plant(0.95 * np.eye(states), 0.05 * np.eye(states), owned, dt=dt, name="Made-up reactor")


def made_run(
    states: int = 3,
    sensors: int = 5,
    samples: int = 300,
    *,
    liars: tuple[int, ...] = (),
    since: int = 100,
    names: list[str] | None = None,
    time: NDArray[Any] | None = None,
) -> Run:
    """A run in which `liars` (indices) are suspected from sample `since` to the end, and add SHIFT kPa."""
    plant = made_plant(states, sensors, names=names)
    rng = np.random.default_rng(2)
    suspected = np.zeros((samples, sensors), dtype=bool)
    suspected[since:, list(liars)] = True
    noise = rng.standard_normal((samples, plant.m))
    attack = np.where(suspected, SHIFT + 0.5 * noise, 0.0)
    x = np.cumsum(0.1 * rng.standard_normal((samples, states)), axis=0)
    fast = np.where(suspected.any(axis=1), 0.0, 1.0)
    return Run(
        plant=plant,
        estimator="SparseFusion",
        settings={"form": "robust", "kalman_probability": 0.95, "refit": True},
        x=x,
        x_std=np.full((samples, states), 0.3),
        P=None,
        trust=np.where(suspected, 0.05, 1.0 - 0.1 * rng.random((samples, sensors))),
        attack=attack,
        attack_std=np.where(suspected, 0.5, np.nan),
        suspected=suspected,
        innovation=2.0 * noise + attack,
        innovation_std=np.full((samples, plant.m), 2.0),
        status=np.zeros(samples, dtype=np.uint8),
        diagnostics={
            "fast_path": fast,
            "iterations": np.where(fast == 1, 0.0, 7.0),
            "gap": 1e-12 * (1 - fast),
        },
        time=time,
    )


def unchecked(run: Run, sensors: tuple[int, ...]) -> Run:
    """The same run of the same plant, in which nobody vouches for these sensors."""
    plant = run.plant
    kept = [s.replaced(verifiable=i not in sensors) for i, s in enumerate(plant.sensors)]
    marked = Plant(plant.A, plant.Q, kept, dt=plant.dt, name=plant.name)
    trust = np.where(marked.uncheckable & ~run.suspected, np.nan, run.trust)
    return replace(run, plant=marked, trust=trust)


def with_silence(run: Run, sensor: int, samples: slice) -> Run:
    """The same run with nothing received from one sensor in some samples."""
    trust, innovation, attack = run.trust.copy(), run.innovation.copy(), run.attack.copy()
    suspected = run.suspected.copy()
    for array in (trust, innovation, attack):
        array[samples, sensor] = np.nan
    suspected[samples, sensor] = False
    return replace(run, trust=trust, innovation=innovation, attack=attack, suspected=suspected)


def made_lies(
    added: dict[int, NDArray[np.float64]], samples: int = 400, *, sensors: int = 5, rate: float | None = None
) -> Run:
    """A run in which sensors are suspected where `added`, (samples,), is a number: what they add, in kPa.

    Estimates of it have an error of 0.5 kPa.
    """
    run = made_run(sensors=sensors, samples=samples)
    error = 0.5 * np.random.default_rng(3).standard_normal((samples, sensors))
    attack = np.zeros((samples, sensors))
    suspected = np.zeros((samples, sensors), dtype=bool)
    for i, values in added.items():
        suspected[:, i] = np.isfinite(values)
        attack[:, i] = np.where(suspected[:, i], values + error[:, i], 0.0)
    return replace(
        run,
        suspected=suspected,
        attack=attack,
        attack_std=np.where(suspected, 0.5, np.nan),
        trust=np.where(suspected, 0.05, 0.95),
        settings={} if rate is None else {"false_alarm_rate": rate},
    )


def lie(start: int, stop: int, size: float = SHIFT, samples: int = 400) -> NDArray[np.float64]:
    """The same addition from `start` to before `stop`, NaN elsewhere, (samples,)."""
    values = np.full(samples, np.nan)
    values[start:stop] = size
    return values
