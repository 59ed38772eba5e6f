"""A drift that wanders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks._arguments import choice, not_negative
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors, Size, Unit


@final
@dataclass(frozen=True)
class RandomWalk(SensorAttack):
    """a[k] = a[k-1] + e[k] from a[start] = e[start] on, e white and Gaussian.

    Args:
        std: standard deviation of a step, >= 0; one number, or one per channel of the plant.
        unit: "sensor": the sensor's unit. "noise": standard deviations of its noise.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    Examples:
        >>> RandomWalk(0.5, unit="noise", on="level", start=30).std
        0.5
    """

    std: Size
    unit: Unit = "sensor"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(std=not_negative("std", self.std), unit=choice("unit", self.unit, Unit))

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        _, steps, m = view.shape

        e = np.where(view.elapsed >= 0, view.draw(lambda rng: rng.standard_normal((steps, m))), 0.0)
        walk: Float = np.cumsum(e, axis=1)
        return view.sized("std", self.std, self.unit) * walk
