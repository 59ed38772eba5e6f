"""A sine wave added to what a sensor sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks._arguments import choice, number, per_channel, positive
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors, Size, Unit


@final
@dataclass(frozen=True)
class Sinusoid(SensorAttack):
    """a = amplitude sin(2 pi (k - start) / period + phase).

    Period 2 with phase 90 alternates between +amplitude and -amplitude.

    Args:
        amplitude: one number, or one per channel of the plant.
        period: in samples, > 0.
        phase: at the start, in degrees.
        unit: "sensor": the amplitude is in the sensor's unit. "noise": in standard deviations of its noise.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    Examples:
        >>> Sinusoid(2.0, period=12, on=0).period
        12.0
    """

    amplitude: Size
    period: float
    phase: float = 0.0
    unit: Unit = "sensor"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(
            amplitude=per_channel("amplitude", self.amplitude),
            period=positive("period", self.period),
            phase=number("phase", self.phase),
            unit=choice("unit", self.unit, Unit),
        )

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        turns = np.mod(view.elapsed / self.period + self.phase / 360, 1.0)
        return view.sized("amplitude", self.amplitude, self.unit) * np.sin(2 * np.pi * turns)
