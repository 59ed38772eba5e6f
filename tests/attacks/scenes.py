"""Plants and clean trajectories for the tests of adversaries."""

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from securestate import Plant, Sensor
from securestate.attacks import Attack
from securestate.attacks.knowledge import Scene

Float = NDArray[np.float64]


def vehicle(**options: Any) -> Plant:
    """Four states, four sensors with five channels, an input with feedthrough, and units of their own."""
    axis = np.array([[1.0, 0.5], [0.0, 0.95]])
    sensors = [
        Sensor("x", C=[1, 0, 0, 0], R=1.0, offset=10.0, scale=2.0),
        Sensor("y", C=[0, 0, 2, 0], R=2.0, scale=0.5, offset=-3.0),
        Sensor(
            "gps",
            C=[[1, 0, 0, 0], [0, 0, 1, 0]],
            R=[[1.0, 0.3], [0.3, 2.0]],
            scale=[3.0, 0.1],
            D=[[0.5], [0]],
        ),
        Sensor("speed", C=[0, 1, 0, 1], R=0.5, protected=True),
    ]
    settings: dict[str, Any] = {
        "B": [[0.0], [1.0], [0.0], [0.3]],
        "input_offset": 1.0,
        "input_scale": 2.0,
    }
    return Plant(np.kron(np.eye(2), axis), np.diag([0.1, 0.2, 0.1, 0.2]), sensors, **(settings | options))


def many(n_sensors: int = 7) -> Plant:
    """One state, seen by many sensors."""
    sensors = [Sensor(f"s{i}", C=[1 + i / 5], R=1 + i / 3) for i in range(n_sensors)]
    return Plant([[0.9]], [[1.0]], sensors)


def scene(plant: Plant, steps: int = 40, runs: int = 3, *, first: int = 0, seed: int = 0) -> Scene:
    """Runs `first`, `first + 1`, ... of the plant; a run is the same in any batch."""
    each = [_run(plant, steps, np.random.default_rng([seed, first + i])) for i in range(runs)]
    x, u, v, y = (np.stack(arrays) for arrays in zip(*each, strict=True))

    def rngs(number: int) -> list[Generator]:
        return [np.random.default_rng([seed, first + i, number]) for i in range(runs)]

    return Scene(plant, x, u, v, y, rngs)


def _run(plant: Plant, steps: int, rng: Generator) -> tuple[Float, Float, Float, Float]:
    x = np.zeros((steps, plant.n))
    u = rng.normal(size=(steps, plant.n_inputs))
    ut = plant.normalise_input(u)
    w = rng.multivariate_normal(np.zeros(plant.n), plant.Q, size=steps)
    v = rng.multivariate_normal(np.zeros(plant.m), plant.R, size=steps)
    for k in range(steps - 1):
        x[k + 1] = plant.A @ x[k] + plant.B @ ut[k] + w[k]
    return x, u, plant.scale * v, plant.denormalise(x @ plant.C.T + ut @ plant.D.T + v)


def injected(attack: Attack, given: Scene) -> Float:
    """What the adversary injects, (runs, T, m)."""
    return attack.stage(given).a
