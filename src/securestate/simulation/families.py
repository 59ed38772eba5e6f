"""Plants drawn at random, a fresh one for every run: the systems on which the papers compare.

References:
    Zhu et al. 2022, Section 4 (scalar); Guo et al. 2019.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from securestate._checks import whole_number
from securestate.errors import InputError
from securestate.plant import Plant, Sensor

Float = NDArray[np.float64]


@final
@dataclass(frozen=True)
class PlantFamily:
    """A rule that draws a plant; all have the same sizes.

    Args:
        name: for tables.
        rule: given a generator, a plant.
        runs_per_plant: so many consecutive runs share one plant.
    """

    name: str
    rule: Callable[[Generator], Plant]
    runs_per_plant: int = 1

    def __post_init__(self) -> None:
        whole_number("runs_per_plant", self.runs_per_plant, 1, InputError)


def scalar(rng: Generator) -> Plant:
    """One state and 15 sensors: A ~ U(.4, .99), Q ~ U(.5, 2), C_i and R_i ~ U(1, 2)."""
    A, Q = rng.uniform(0.4, 0.99), rng.uniform(0.5, 2.0)
    C, R = rng.uniform(1, 2, 15), rng.uniform(1, 2, 15)
    sensors = [Sensor(f"s{i + 1}", C=[C[i]], R=R[i]) for i in range(15)]
    return Plant([[A]], [[Q]], sensors, name="scalar, 15 sensors")


def full_planar(rng: Generator) -> Plant:
    """Position and velocity in the plane; each of 15 sensors sees both positions, turned by an angle."""
    Q = _planar_noise(rng)
    angle, size = rng.uniform(0, 2 * np.pi, 15), rng.uniform(1, 2, 15)
    R = rng.uniform(1, 2, 15)
    c, s, zero = size * np.cos(angle), size * np.sin(angle), np.zeros(15)
    C = np.stack([np.stack([c, zero, -s, zero], axis=1), np.stack([s, zero, c, zero], axis=1)], axis=1)
    sensors = [Sensor(f"s{i + 1}", C=C[i], R=R[i]) for i in range(15)]
    return Plant(_planar_motion(1.0), Q, sensors, name="planar, every sensor sees both axes")


def partial_planar(rng: Generator) -> Plant:
    """Position and velocity in the plane, 15 scalar sensors of which each sees one axis only, in turn."""
    Q = _planar_noise(rng)
    size, R = rng.uniform(1, 2, 15), rng.uniform(1, 2, 15)
    C = np.zeros((15, 4))
    C[np.arange(15), 2 * (np.arange(15) % 2)] = size
    sensors = [Sensor(f"s{i + 1}", C=C[i], R=R[i]) for i in range(15)]
    return Plant(_planar_motion(0.98), Q, sensors, name="planar, every sensor sees one axis")


def _planar_motion(decay: float) -> Float:
    """Two axes of position and velocity, sampled every half second."""
    axis = decay * np.array([[1.0, 0.5], [0.0, 0.95]])
    return np.asarray(np.kron(np.eye(2), axis), dtype=np.float64)


def _planar_noise(rng: Generator) -> Float:
    push = np.array([[0.125], [0.5]])
    axis = (push @ push.T + 0.01 * np.eye(2)) * rng.uniform(0.5, 2.0)
    return np.asarray(np.kron(np.eye(2), axis), dtype=np.float64)


#: The families that configuration files know by name.
FAMILIES: Mapping[str, Callable[[Generator], Plant]] = {
    "scalar": scalar,
    "full-planar": full_planar,
    "partial-planar": partial_planar,
}
