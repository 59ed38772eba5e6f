"""A constant added to what a sensor sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from securestate.attacks.base import Float, OwnSensors, SensorAttack, Unit


@final
@dataclass(frozen=True)
class Bias(SensorAttack):
    """a = size.

    Args:
        size: one number, or one per channel of the plant, in the sensor's unit.
        unit: "noise": the size is in standard deviations of the channel's measurement noise.
        on, start, stop: as for `SingleAttack`.

    Examples:
        >>> Bias(2.0, on="gps 2", start=100) + Bias(-2.0, on="radar", start=100, stop=200)
        Combination(...)
    """

    size: float | tuple[float, ...]
    unit: Unit = "sensor"

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        return view.sized("size", self.size, self.unit)
