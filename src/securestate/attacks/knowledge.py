"""What adversaries may know, and the scene that they are shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from securestate.errors import InputError
from securestate.plant import Plant

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

#: "sensor": the sensor's own unit. "noise": standard deviations of its measurement noise.
Unit = Literal["sensor", "noise"]

#: One number for all channels, or one per channel of the plant.
Size = float | Sequence[float]


class Knowledge(StrEnum):
    """What an adversary knows."""

    OWN_SENSORS = "its own sensors"
    PLANT = "the plant and its own sensors"
    EVERYTHING = "the plant, the state and the noise"
    DEFENDER = "everything, and what the defender expects"


@dataclass(frozen=True, eq=False)
class OwnSensors:
    """What can be read off the sensors under attack, for a batch of runs.

    Attributes:
        y: clean readings, (runs, T, m), sensor units; NaN on every sensor that is never attacked in that run.
        attacked: sensors controlled at each sample, (runs, T, N).
        start, stop: first sample under attack and the first one after it.
        noise: standard deviation of the measurement noise, (m,), sensor units.
        channel_sensor: owner of every channel, (m,).
        rngs: one generator per run, always the same: a draw goes on where the one before ended.
    """

    y: Float
    attacked: Bool
    start: int
    stop: int
    noise: Float
    channel_sensor: NDArray[np.int64]
    rngs: Callable[[], Sequence[Generator]]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(runs, T, m)."""
        runs, steps, m = self.y.shape
        return runs, steps, m

    @property
    def elapsed(self) -> Float:
        """Samples since the start, (T, 1); negative before it."""
        return (np.arange(self.y.shape[1], dtype=np.float64) - self.start)[:, np.newaxis]

    def unit(self, unit: Unit) -> Float:
        """How much one unit is on each channel in sensor units, (m,)."""
        return self.noise if unit == "noise" else np.ones_like(self.noise)

    def sized(self, argument: str, size: Size, unit: Unit) -> Float:
        """A number, or one per channel, in sensor units, (m,).

        Raises:
            InputError: there are neither one nor as many numbers as channels.
        """
        values = np.asarray(size, dtype=np.float64)
        if values.shape not in ((), self.noise.shape):
            raise InputError(argument, f"one number or {len(self.noise)}, one per channel", f"{values.size}")
        return values * self.unit(unit)

    def draw(self, one: Callable[[Generator], Float]) -> Float:
        """Stack what `one` draws for each run, so that a run has the same numbers in any batch."""
        return np.stack([one(rng) for rng in self.rngs()])


@dataclass(frozen=True, eq=False)
class PlantKnowledge(OwnSensors):
    """Also the plant, and its inputs u (runs, T, p) in file units."""

    plant: Plant
    u: Float

    def told(self, d: Float) -> Float:
        """What the sensors add if all claim that the state is x + d: scale C d for d (T, n), sensor units."""
        C = self.plant.C[: len(d)] if self.plant.C.ndim == 3 else self.plant.C
        shift: Float = (C @ d[:, :, np.newaxis])[:, :, 0]
        return self.plant.scale * shift


@dataclass(frozen=True, eq=False)
class Everything(PlantKnowledge):
    """Also the true state x (runs, T, n), the noise v (runs, T, m) and all clean readings, sensor units."""

    x: Float
    v: Float
    all_y: Float


@dataclass(frozen=True, eq=False)
class Scene:
    """A plant's clean trajectories, as the simulator hands them to adversaries.

    Attributes:
        plant: the plant.
        x: true states, (runs, T, n), normalised units.
        u: inputs, (runs, T, p), file units.
        v: measurement noise, (runs, T, m), sensor units.
        y: clean readings, (runs, T, m), sensor units.
        rngs: given the number of an adversary in a sum, one fresh generator per run. The adversary draws its
            sensors from it first, then its signal.
    """

    plant: Plant
    x: Float
    u: Float
    v: Float
    y: Float
    rngs: Callable[[int], Sequence[Generator]]
