"""A sensor that stops at its last right reading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors


@final
@dataclass(frozen=True)
class Freeze(SensorAttack):
    """a[k] = y[start - 1] - y[k]; at start 0 the first reading is the one that stays.

    Args:
        on, start, stop: as for `SingleAttack`.

    Examples:
        >>> Freeze(on="level", start=100)
        Freeze(on=Fixed(sensors=('level',)), start=100, stop=None)
    """

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        last = min(max(self.start - 1, 0), view.shape[1] - 1)
        return view.y[:, [last]] - view.y
