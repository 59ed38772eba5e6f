"""White noise added to what a sensor sends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.random import Generator

from securestate.attacks import _arguments as argument
from securestate.attacks.base import SensorAttack
from securestate.attacks.knowledge import Float, OwnSensors, Size, Unit
from securestate.errors import InputError

Distribution = Literal["gaussian", "laplace"]


@final
@dataclass(frozen=True)
class RandomNoise(SensorAttack):
    """White noise with a given standard deviation or covariance.

    With a covariance S, a = L e where L L' = S and the entries of e are independent with variance 1.

    Args:
        std: standard deviation >= 0; one number, or one per channel of the plant.
        covariance: in place of `std`: positive semidefinite (m, m), over all channels of the plant; what it
            says of sensors that are not attacked is ignored.
        distribution: of the independent entries: "gaussian", or "laplace" with its heavier tails.
        unit: "sensor": the sensor's unit, squared in a covariance. "noise": standard deviations of its noise.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these, or not exactly one of `std` and `covariance` is given.

    Examples:
        >>> RandomNoise(10.0, distribution="laplace", unit="noise", on="radar").std
        10.0
        >>> RandomNoise(covariance=[[4.0, 2.0], [2.0, 1.0]], on=["a", "b"]).covariance
        ((4.0, 2.0), (2.0, 1.0))
    """

    std: Size | None = None
    covariance: Sequence[Sequence[float]] | None = None
    distribution: Distribution = "gaussian"
    unit: Unit = "sensor"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(
            distribution=argument.choice("distribution", self.distribution, Distribution),
            unit=argument.choice("unit", self.unit, Unit),
        )
        if (self.std is None) == (self.covariance is None):
            raise InputError("std", "either std or covariance", "both" if self.covariance else "neither")
        if self.std is not None:
            self._keep(std=argument.not_negative("std", self.std))
        else:
            self._keep(covariance=argument.covariance("covariance", self.covariance))

    def inject(self, view: OwnSensors) -> Float:
        """See `OpenLoopAttack.inject`."""
        _, steps, m = view.shape

        def white(rng: Generator) -> Float:
            if self.distribution == "gaussian":
                return rng.standard_normal((steps, m))
            return rng.laplace(scale=np.sqrt(0.5), size=(steps, m))

        if self.std is not None:
            return view.sized("std", self.std, self.unit) * view.draw(white)
        coloured: Float = view.draw(white) @ self._root(m).T
        return view.unit(self.unit) * coloured

    def _root(self, m: int) -> Float:
        """L with L L' = covariance, (m, m)."""
        S = np.asarray(self.covariance, dtype=np.float64)
        if len(S) != m:
            raise InputError("covariance", f"({m}, {m}), one row per channel", f"{S.shape}")
        variances, directions = np.linalg.eigh(S)
        root: Float = directions * np.sqrt(np.maximum(variances, 0.0))
        return root
