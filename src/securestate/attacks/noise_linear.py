"""A lie that hides in the measurement noise: attack (25) of Zhu et al."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

from securestate.attacks._arguments import choice, interval
from securestate.attacks.base import OmniscientAttack
from securestate.attacks.knowledge import Everything, Float, Unit

Redraw = Literal["sample", "sensor", "run"]


@final
@dataclass(frozen=True)
class NoiseLinear(OmniscientAttack):
    """a = beta v + theta, v the measurement noise, beta and theta uniform in their intervals.

    Args:
        beta: interval (low, high) of the factor.
        theta: interval (low, high) of what is added.
        redraw: "sample": each sensor draws both afresh at every sample. "sensor": once per run.
            "run": all sensors share one pair per run.
        unit: of theta: "sensor": the sensor's unit. "noise": standard deviations of its noise.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these.

    References:
        Zhu et al. 2022, (25). The paper does not say how often beta and theta are drawn.

    Examples:
        >>> from securestate.attacks import Redrawn
        >>> dynamic = NoiseLinear(on=Redrawn((1, 6)), start=30)
        >>> dynamic.beta, dynamic.theta
        ((-5.0, 5.0), (-10.0, 10.0))
    """

    beta: tuple[float, float] = (-5.0, 5.0)
    theta: tuple[float, float] = (-10.0, 10.0)
    redraw: Redraw = "sample"
    unit: Unit = "sensor"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(
            beta=interval("beta", self.beta),
            theta=interval("theta", self.theta),
            redraw=choice("redraw", self.redraw, Redraw),
            unit=choice("unit", self.unit, Unit),
        )

    def inject(self, view: Everything) -> Float:
        """See `OpenLoopAttack.inject`."""
        _, steps, n_sensors = view.attacked.shape
        times = steps if self.redraw == "sample" else 1
        sources = 1 if self.redraw == "run" else n_sensors
        owner = view.channel_sensor if sources > 1 else view.channel_sensor * 0

        drawn = view.draw(lambda rng: rng.uniform(size=(2, times, sources)))[..., owner]
        beta, theta = _within(self.beta, drawn[:, 0]), _within(self.theta, drawn[:, 1])
        return beta * view.v + theta * view.unit(self.unit)


def _within(bounds: tuple[float, float], share: Float) -> Float:
    low, high = bounds
    return low + (high - low) * share
