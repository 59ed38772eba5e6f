"""Sensors that agree on the same wrong state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from securestate._steady_state import steady_state
from securestate.attacks._arguments import choice, number, per_channel, positive
from securestate.attacks.base import PlantAttack
from securestate.attacks.knowledge import Float, PlantKnowledge, Size
from securestate.errors import InputError

Profile = Literal["constant", "ramp", "sinusoid"]
Along = Literal["states", "prior"]


@final
@dataclass(frozen=True)
class FakeState(PlantAttack):
    """a = scale C[k] d[k]: every attacked sensor claims that the state is x[k] + d[k].

        "constant":  d = shift
        "ramp":      d = shift (k - start)
        "sinusoid":  d = shift sin(2 pi (k - start) / period)

    Args:
        shift: in normalised units; one number for all states, or one per state.
        profile: over time, as above.
        period: of the sinusoid, in samples, > 0.
        along: "prior": the shift is one number of prior standard deviations in the direction in which the
            Kalman filter of all sensors is least certain: shift sqrt(p) q, with p the largest eigenvalue of
            the steady P[k|k-1] and q its eigenvector, largest entry positive.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these; when staged: shift is neither one number nor one per state.
        DesignError: when staged, along "prior": the plant has no steady state.

    Examples:
        >>> FakeState((0.0, 2.0), on=["a", "b"], start=100).shift
        (0.0, 2.0)
        >>> subtle = FakeState(3.0, along="prior", on=[0, 1, 2])
    """

    shift: Size
    profile: Profile = "constant"
    period: float | None = None
    along: Along = "states"

    def __post_init__(self) -> None:
        super().__post_init__()
        along = choice("along", self.along, Along)
        checked = per_channel if along == "states" else number
        self._keep(
            shift=checked("shift", self.shift), profile=choice("profile", self.profile, Profile), along=along
        )
        if self.profile == "sinusoid":
            self._keep(period=positive("period", self.period))
        elif self.period is not None:
            raise InputError("period", "None, because only a sinusoid has one", repr(self.period))

    def inject(self, view: PlantKnowledge) -> Float:
        """See `OpenLoopAttack.inject`."""
        return view.told(self._over_time(view.elapsed) * self._direction(view))

    def _over_time(self, elapsed: Float) -> Float:
        if self.profile == "constant":
            return np.ones_like(elapsed)
        if self.period is None:
            return elapsed
        wave: Float = np.sin(2 * np.pi * np.mod(elapsed / self.period, 1.0))
        return wave

    def _direction(self, view: PlantKnowledge) -> Float:
        """The shift of all states, (n,)."""
        shift, n = np.asarray(self.shift, dtype=np.float64), view.plant.n
        if self.along == "prior":
            variances, directions = np.linalg.eigh(steady_state(view.plant).P_prior)
            q: Float = directions[:, -1] * np.sign(directions[np.argmax(np.abs(directions[:, -1])), -1])
            largest: Float = shift * np.sqrt(variances[-1]) * q
            return largest
        if shift.shape not in ((), (n,)):
            raise InputError("shift", f"one number or {n}, one per state", f"{shift.size}")
        return np.broadcast_to(shift, (n,))
