"""A drift at constant speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks._arguments import choice, per_channel, positive
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors, Size, Unit


@final
@dataclass(frozen=True)
class Ramp(SensorAttack):
    """a = slope (k - start), held where its magnitude reaches the limit.

    The first sample under attack is therefore still right.

    Args:
        slope: per sample; one number, or one per channel of the plant.
        limit: largest magnitude, > 0, in the same unit; None: none.
        unit: "sensor": the sensor's unit. "noise": standard deviations of its noise.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    Examples:
        >>> Ramp(0.1, limit=3.0, on="level", start=50)
        Ramp(on=Fixed(sensors=('level',)), start=50, stop=None, slope=0.1, limit=3.0, unit='sensor')
    """

    slope: Size
    limit: float | None = None
    unit: Unit = "sensor"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(
            slope=per_channel("slope", self.slope),
            limit=None if self.limit is None else positive("limit", self.limit),
            unit=choice("unit", self.unit, Unit),
        )

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        a = view.sized("slope", self.slope, self.unit) * view.elapsed
        if self.limit is None:
            return a
        limit = view.sized("limit", self.limit, self.unit)
        return np.clip(a, -limit, limit)
