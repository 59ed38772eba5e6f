"""Readings that are stretched, shrunk or mirrored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from securestate.attacks._arguments import per_channel
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors, Size


@final
@dataclass(frozen=True)
class Scale(SensorAttack):
    """The sensor sends about + factor (y - about), so a = (factor - 1) (y - about).

    Factor 0 sends the number `about` itself.

    Args:
        factor: one number, or one per channel of the plant.
        about: reading that stays as it is, in the sensor's unit; one number, or one per channel.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    Examples:
        >>> silent = Scale(0.0, on="flow")
        >>> sluggish = Scale(0.5, about=20.0, on="temperature", start=60)
    """

    factor: Size
    about: Size = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(factor=per_channel("factor", self.factor), about=per_channel("about", self.about))

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        factor = view.sized("factor", self.factor, "sensor")
        return (factor - 1.0) * (view.y - view.sized("about", self.about, "sensor"))
