"""Short impulses, regular or at random."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks import _arguments as argument
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors, Size, Unit
from securestate.errors import InputError


@final
@dataclass(frozen=True)
class Pulse(SensorAttack):
    """Impulses of a given size: once at the start, every so many samples, or at random.

        every:        a = size   where (k - start) mod every < width
        probability:  a = ±size  for `width` samples from each k that a coin picks, a new coin per channel

    A random impulse that begins during another one replaces it.

    Args:
        size: one number, or one per channel of the plant.
        every: samples from one impulse to the next, >= width.
        probability: that an impulse begins at a sample, for each channel; its sign is random.
        width: samples that an impulse lasts.
        unit: "sensor": the size is in the sensor's unit. "noise": in standard deviations of its noise.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these, or both `every` and `probability` are given.

    Examples:
        >>> once = Pulse(3.0, on="weak", start=50)
        >>> often = Pulse(5.0, probability=0.1, unit="noise", on=[0, 1])
    """

    size: Size
    every: int | None = None
    probability: float | None = None
    width: int = 1
    unit: Unit = "sensor"

    def __post_init__(self) -> None:
        super().__post_init__()
        width = argument.whole("width", self.width, 1)
        self._keep(size=argument.per_channel("size", self.size), width=width)
        self._keep(unit=argument.choice("unit", self.unit, Unit))
        if self.every is not None:
            self._keep(every=argument.whole("every", self.every, width))
        if self.probability is not None:
            self._keep(probability=argument.probability("probability", self.probability))
            if self.every is not None:
                raise InputError("probability", "None, because `every` is given", repr(self.probability))

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        size = view.sized("size", self.size, self.unit)
        if self.probability is not None:
            return size * self._random_signs(view, self.probability)
        elapsed = view.elapsed if self.every is None else np.mod(view.elapsed, self.every)
        return size * ((elapsed >= 0) & (elapsed < self.width))

    def _random_signs(self, view: OwnSensors, probability: float) -> Float:
        """-1, 0 or 1 at every sample, (runs, T, m)."""
        _, steps, m = view.shape

        drawn = view.draw(lambda rng: rng.random((steps, m)))
        k = np.arange(steps)[:, np.newaxis]
        begins = (drawn < probability) & (k >= view.start)
        latest = np.maximum.accumulate(np.where(begins, k, -1), axis=1)
        # Given that it is below the probability, the drawn number is uniform again: its half gives the sign.
        signs = np.where(drawn < probability / 2, -1.0, 1.0)
        on = (latest >= 0) & (k - latest < self.width)
        return np.where(on, np.take_along_axis(signs, np.maximum(latest, 0), axis=1), 0.0)
