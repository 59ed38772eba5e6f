"""Old readings sent again and again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks._arguments import whole
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors
from securestate.errors import InputError


@final
@dataclass(frozen=True)
class Replay(SensorAttack):
    """Records the `length` samples before the start and sends them in a loop.

        a[k] = y[start - length + (k - start) mod length] - y[k]

    Args:
        length: samples recorded, at most `start`.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    References:
        Mo, Sinopoli 2009.

    Examples:
        >>> Replay(20, on="level", start=10)
        Traceback (most recent call last):
        securestate.errors.InputError: start: expected at least 20, the samples to record, received 10
    """

    length: int

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(length=whole("length", self.length, 1))
        if self.start < self.length:
            raise InputError("start", f"at least {self.length}, the samples to record", f"{self.start}")

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        k = np.arange(view.shape[1])
        recorded = self.start - self.length + np.mod(k - self.start, self.length)
        return view.y[:, np.where(k < self.start, k, recorded)] - view.y
