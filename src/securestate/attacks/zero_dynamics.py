"""A lie that grows along a mode which no honest sensor sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate._steady_state import steady_state
from securestate.attacks._arguments import positive
from securestate.attacks._modal import along_mode
from securestate.attacks.base import PlantAttack
from securestate.attacks.knowledge import Float, PlantKnowledge
from securestate.attacks.targets import Fixed
from securestate.errors import DesignError, InputError
from securestate.plant import Plant
from securestate.resilience import Mode, modes, undetectable_modes
from securestate.resilience.margin import noise_scaled

#: Default size: innovations of the steady Kalman filter change by this many of their standard deviations.
QUIET = 1e-10

#: Samples after the start over which that change is looked at.
HORIZON = 1000

#: Part of what a sensor sees of a direction, relative to what it could see at most, that counts as nothing.
BLIND = 1e-8


@final
@dataclass(frozen=True)
class ZeroDynamics(PlantAttack):
    """a = scale C d[k], d[k] = Re(size lambda^(k - start) v): the plant's own motion along a hidden mode.

    (lambda, v) is the mode with the largest |lambda| >= 1 that the sensors left alone do not see, while one
    of the attacked ones does. From the start on, all readings together are those of a state x + d that obeys
    the plant. No estimator can tell it from x: its error grows as |lambda|^k, its innovations show nothing.

    But for the first step. Before the start d is zero, at the start it is size v. The plant's own motion
    never leads from zero to v, so the step C d cannot be avoided: a lie that starts from exactly zero stays
    zero. A filter sees that step as an innovation, which dies out while d grows. So the size is tiny by
    default, and the harm takes its time: growth by 1e10 needs 23 / log|lambda| samples.

    A marginal mode, |lambda| = 1, does not grow: the lie keeps the size of its first step, and with the
    default size does no harm. There, push slowly: `FakeState(shift, profile="ramp")` along that mode.

    Args:
        size: length of d at the start, normalised units, > 0. Default: innovations of the steady-state Kalman
            filter change by at most 1e-10 of their standard deviations, as far as rounding allows.
        on: named sensors; the mode stays hidden only while they are the same.
        start, stop: as for `SingleAttack`.

    Raises:
        InputError: size is not > 0, or `on` is drawn or changes.
        DesignError: when staged: the sensors left alone see every mode with |lambda| >= 1, or no sensor sees
            the hidden ones; the plant varies in time; or the default size is asked for and there is no steady
            state.

    Notes:
        The lie is held once it is 1e100 times its first step.

    References:
        Teixeira et al. 2015; Pasqualetti, Dörfler, Bullo 2013.

    Examples:
        >>> ZeroDynamics(on=["gps", "odometer"], start=100)
        ZeroDynamics(on=Fixed(sensors=('gps', 'odometer')), start=100, stop=None, size=None)
    """

    size: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_fixed(self.on)
        if self.size is not None:
            self._keep(size=positive("size", self.size))

    def inject(self, view: PlantKnowledge) -> Float:
        """See `OpenLoopAttack.inject`."""
        mode = hidden_mode(view.plant, require_fixed(self.on).indices(view.plant))
        size = quiet_size(view.plant, mode) if self.size is None else self.size
        return view.told(along_mode(mode, size, view.elapsed))


def require_fixed(on: object) -> Fixed:
    """Return the rule, if it names the same sensors at all times."""
    if not isinstance(on, Fixed):
        raise InputError("on", "named sensors, the same at all times", repr(on))
    return on


def hidden_mode(plant: Plant, attacked: list[int]) -> Mode:
    """The largest mode with |lambda| >= 1 that only attacked sensors see."""
    honest = [i for i in range(plant.n_sensors) if i not in attacked]
    hidden = undetectable_modes(plant.select(honest)) if honest else modes(plant)
    X = noise_scaled(plant)
    largest = np.linalg.norm(X, axis=1)
    for mode in hidden:
        if np.any(np.abs(X @ mode.direction) > BLIND * largest):
            return mode
    if hidden:
        raise DesignError(f"no sensor sees {hidden[0]}, so that no lie is needed to lose it", "")
    names = ", ".join(plant.sensor_names[i] for i in honest)
    raise DesignError(
        f"the sensors left alone ({names}) see every mode that does not fade",
        "attack more sensors, or use WorstCase for what the others see least",
    )


def quiet_size(plant: Plant, mode: Mode) -> float:
    """The size with which innovations of the steady Kalman filter change by at most `QUIET` deviations.

    After the start x + d - x[k|k-1] differs from x - x[k|k-1] by delta: delta[start] = size v, and from then
    on delta moves by A (I - K C), whatever the plant does.
    """
    try:
        steady = steady_state(plant)
    except DesignError as refusal:
        raise DesignError(f"the default size needs a steady state: {refusal.reason}", "give a size") from None
    std, delta, peak = np.sqrt(np.diag(steady.innovation_cov)), mode.direction, 0.0
    for _ in range(HORIZON):
        innovation = plant.C @ delta
        peak = max(peak, float(np.max(np.abs(innovation) / std)))
        delta = plant.A @ (delta - steady.gain @ innovation)
    return QUIET / peak
