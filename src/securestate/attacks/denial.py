"""Readings that never arrive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks import _arguments as argument
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors


@final
@dataclass(frozen=True)
class Denial(SensorAttack):
    """Suppresses what a sensor sends, with all its channels: a = NaN with the given probability, else 0.

    Args:
        probability: that a sample of a sensor is lost.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    Examples:
        >>> silence = Denial(on="gps", start=100, stop=160)
        >>> bad_line = Denial(0.3, on=["a", "b"])
    """

    probability: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(probability=argument.probability("probability", self.probability))

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        _, steps, n_sensors = view.attacked.shape

        lost = view.draw(lambda rng: rng.random((steps, n_sensors))) < self.probability
        return np.where(lost[..., view.channel_sensor], np.nan, 0.0)
