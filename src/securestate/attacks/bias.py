"""A constant added to what a sensor sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

from securestate.attacks._arguments import choice, per_channel
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors, Size, Unit

Signs = Literal["fixed", "random"]


@final
@dataclass(frozen=True)
class Bias(SensorAttack):
    """a = size.

    Args:
        size: one number, or one per channel of the plant.
        unit: "sensor": the size is in the sensor's unit. "noise": in standard deviations of its noise.
        signs: "random": every channel draws the sign of its bias once per run.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    Examples:
        >>> both = Bias(2.0, on="gps 2", start=100) + Bias(-2.0, on="radar", start=100, stop=200)
        >>> both.parts[1]
        Bias(on=Fixed(sensors=('radar',)), start=100, stop=200, size=-2.0, unit='sensor', signs='fixed')
    """

    size: Size
    unit: Unit = "sensor"
    signs: Signs = "fixed"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(
            size=per_channel("size", self.size),
            unit=choice("unit", self.unit, Unit),
            signs=choice("signs", self.signs, Signs),
        )

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        size = view.sized("size", self.size, self.unit)
        if self.signs == "fixed":
            return size

        return size * view.draw(lambda rng: rng.choice([-1.0, 1.0], (1, len(size))))
