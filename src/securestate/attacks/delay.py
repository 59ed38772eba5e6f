"""Readings that arrive late."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks._arguments import whole
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors


@final
@dataclass(frozen=True)
class Delay(SensorAttack):
    """a[k] = y[k - samples] - y[k]; nothing is sent while there is no reading that old.

    Args:
        samples: how old the readings are, >= 1.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    Examples:
        >>> Delay(3, on="temperature").samples
        3
    """

    samples: int

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(samples=whole("samples", self.samples, 1))

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        a = np.full_like(view.y, np.nan)
        a[:, self.samples :] = view.y[:, : -self.samples] - view.y[:, self.samples :]
        return a
