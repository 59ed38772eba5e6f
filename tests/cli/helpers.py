"""A plant with five flow meters of which files are made: honest, or with one meter lying."""

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import securestate as ss

PLANT = ss.Plant(
    A=[[0.95, 0.1], [0.0, 0.9]],
    Q=0.1 * np.eye(2),
    sensors=[
        ss.Sensor("flow 1", C=[1, 0], R=0.1, unit="m³/h", offset=20, scale=2),
        ss.Sensor("flow 2", C=[1, 0], R=0.1, unit="m³/h"),
        ss.Sensor("flow 3", C=[1, 0.2], R=0.1),
        ss.Sensor("level", C=[[0, 1], [1, 1]], R=0.2, protected=True),
    ],
    dt=0.5,
    name="two tanks",
)


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


Command = Callable[..., Outcome]


def measurements(samples: int, seed: int = 1) -> pd.DataFrame:
    """Return what honest sensors send, with the time."""
    return _measurements(samples, seed).copy()


@cache
def _measurements(samples: int, seed: int) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    noise, process = rng.standard_normal((samples, PLANT.m)), rng.standard_normal((samples, PLANT.n))
    x, y = np.zeros(PLANT.n), np.empty((samples, PLANT.m))
    for k in range(samples):
        y[k] = PLANT.offset + PLANT.scale * (PLANT.C @ x + np.sqrt(np.diag(PLANT.R)) * noise[k])
        x = PLANT.A @ x + np.sqrt(0.1) * process[k]
    frame = pd.DataFrame(y, columns=list(PLANT.channel_names))
    frame.insert(0, "time", PLANT.dt * np.arange(samples))
    return frame


@cache
def plant_file() -> bytes:
    """The plant as a file."""
    with tempfile.TemporaryDirectory() as folder:
        PLANT.save(Path(folder) / "plant.toml")
        return (Path(folder) / "plant.toml").read_bytes()


@cache
def measurement_file(samples: int) -> str:
    """What honest sensors send as a file."""
    return str(measurements(samples).to_csv(index=False))


def history(samples: int, seed: int = 1) -> pd.DataFrame:
    """Return what three honest level meters in one tank say, one sample a minute."""
    rng = np.random.default_rng(seed)
    x = np.zeros(samples)
    for k in range(1, samples):
        x[k] = 0.9 * x[k - 1] + rng.normal()
    y = 20 + 2 * x[:, None] + rng.normal(size=(samples, 3))
    frame = pd.DataFrame(y, columns=["left", "middle", "right"])
    frame.insert(0, "time", 60.0 * np.arange(samples))
    return frame
