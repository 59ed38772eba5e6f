"""How many liars an installation survives, whatever the estimator: its fundamental limit.

A mode that c sensors see is lost when more than half of them lie: the state x with the first half lying and
the state x + v with the second half lying give the same readings, forever. So some estimator survives p liars
if and only if every direction of every relevant mode is seen by more than 2 p sensors that may lie, or by a
protected one.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate._checks import real_array, whole_number
from securestate._threads import one_blas_thread
from securestate.errors import DesignError, InputError
from securestate.plant import Plant
from securestate.resilience._count import Count, least_weight
from securestate.resilience._worst_set import worst_set
from securestate.resilience.detectability import Mode, mode_along
from securestate.resilience.eigenspaces import (
    TOLERANCE,
    Array,
    Eigenspace,
    Indices,
    Sight,
    eigenspaces,
    kernel_of,
    sight,
)
from securestate.resilience.lie import Lie, lie_along
from securestate.resilience.margin import SLOW, noise_scaled

#: Share of a motion that is worth having left.
ROBUST = 0.1
#: Tolerances of a profile.
TOLERANCES = (1e-10, 1e-8, 1e-6, 1e-4, 1e-3)


@final
@dataclass(frozen=True, eq=False)
class ModeLimit:
    """What sensors see of one eigenvalue.

    Attributes:
        lower, upper: bounds of the number of sensors, not protected, that see the direction that fewest see;
            `inf` if protected sensors see every direction.
        mode: that direction; None if protected sensors see every one.
        sensors: those that see it, by name.
        method: what settled the bounds.
        alone: (N,) booleans: the sensors that see every direction by themselves.
        space: the eigenspace.
    """

    space: Eigenspace
    lower: float
    upper: float
    mode: Mode | None
    sensors: tuple[str, ...]
    method: str
    alone: NDArray[np.bool_]

    @property
    def eigenvalue(self) -> complex:
        """The eigenvalue."""
        return self.space.value

    @property
    def multiplicity(self) -> int:
        """Geometric: how many independent directions it has."""
        return self.space.multiplicity

    @property
    def exact(self) -> bool:
        """Whether both bounds agree."""
        return self.lower >= self.upper


@final
@dataclass(frozen=True, eq=False)
class Limit:
    """The fundamental limit over some modes of a plant.

    Attributes:
        plant: the plant.
        cut: the modes with |eigenvalue| >= cut were counted.
        tol: eigenvalues and sensitivities that differ by less are taken for equal and for zero.
        modes: each of them, the one seen by fewest first.
    """

    plant: Plant
    cut: float
    tol: float
    modes: tuple[ModeLimit, ...]

    @property
    def lower(self) -> float:
        """Fewest sensors that see a direction, bound from below; `inf` if nothing has to be seen."""
        return min((mode.lower for mode in self.modes), default=math.inf)

    @property
    def upper(self) -> float:
        """The same, from above."""
        return min((mode.upper for mode in self.modes), default=math.inf)

    @property
    def exact(self) -> bool:
        """Whether both bounds give the same limit."""
        return self.max_attacked == self.max_attacked_upper

    @property
    def max_attacked(self) -> int:
        """Liars that some estimator survives for certain; -1 if not even honest sensors see everything."""
        return self._survives(self.lower)

    @property
    def max_attacked_upper(self) -> int:
        """Liars above which no estimator survives the worst case."""
        return self._survives(self.upper)

    @property
    def unlimited(self) -> bool:
        """Whether all sensors that may lie can do so at once: protected ones see all, or nothing matters."""
        return self.max_attacked == int((~self.plant.protected).sum())

    @property
    def alone(self) -> tuple[str, ...]:
        """The sensors that see every mode by themselves."""
        every = np.ones(self.plant.n_sensors, dtype=bool)
        for mode in self.modes:
            every = every & mode.alone
        return tuple(name for name, sees in zip(self.plant.sensor_names, every, strict=True) if sees)

    @property
    def weakest(self) -> ModeLimit | None:
        """The mode that fewest sensors see; None if protected sensors see all, or no mode counts."""
        return self.modes[0] if self.modes and math.isfinite(self.upper) else None

    def _survives(self, count: float) -> int:
        free = int((~self.plant.protected).sum())
        return free if math.isinf(count) else min(free, max(-1, (int(count) - 1) // 2))

    def margin(self, removed: int, *, time_limit: float = 60.0) -> tuple[float, float]:
        """Bounds of eta: the least share of a motion that is left without the worst `removed` sensors.

        Args:
            removed: how many sensors are taken away.
            time_limit: seconds after which the bounds are what they are.

        0: some motion is lost. eta^2 is the share of information that is left in the worst direction.

        Raises:
            InputError: removed is no whole number >= 0.
        """
        X, free, owner = noise_scaled(self.plant), ~self.plant.protected, self.plant.channel_sensor
        whole_number("removed", removed, 0, InputError)
        if self.upper <= removed:
            return 0.0, 0.0
        each = time_limit / max(1, len(self.modes))
        with one_blas_thread():
            sets = [worst_set(X @ mode.space.V, owner, free, removed, each) for mode in self.modes]
        lower = min((found.lower for found in sets), default=1.0)
        upper = min((found.upper for found in sets), default=1.0)
        return lower, upper

    def robust(self, share: float = ROBUST, *, time_limit: float = 60.0) -> int:
        """Most liars p, up to the limit, for which `margin(2 p)` is certainly at least this share."""
        deadline = time.monotonic() + time_limit
        enough, too_many = 0, max(0, self.max_attacked) + 1
        while too_many - enough > 1 and (left := deadline - time.monotonic()) > 0:
            liars = (enough + too_many) // 2
            if self.margin(2 * liars, time_limit=left / 4)[0] >= share:
                enough = liars
            else:
                too_many = liars
        return enough

    def ambiguity(self, attacked: int) -> tuple[Lie, Lie] | None:
        """Two lies of at most `attacked` sensors each that nobody can tell apart; None if there are none.

        The sensors of the first that say x + d and those of the second that say x - d send the same as long
        as the state is x in the first case and x + d in the second.
        """
        weak = self.weakest
        if weak is None or weak.mode is None or not 0 < weak.upper <= 2 * attacked:
            return None
        X, d = noise_scaled(self.plant), weak.mode.direction
        direction = d if weak.eigenvalue.imag else d.real
        sides = weak.sensors[: (len(weak.sensors) + 1) // 2], weak.sensors[(len(weak.sensors) + 1) // 2 :]
        index = self.plant.sensor_names.index
        lies = [
            lie_along(self.plant, X, tuple(map(index, side)), direction, direction[:, None]) for side in sides
        ]
        return lies[0], lies[1]


def limit(
    plant: Plant,
    cut: float = SLOW,
    *,
    tol: float = TOLERANCE,
    time_limit: float = 60.0,
    target: float = math.inf,
) -> Limit:
    """Count how many sensors see every mode, and who.

    Args:
        plant: time-invariant.
        cut: only modes with |eigenvalue| >= cut count; 0 for all.
        tol: eigenvalues this close, relative to ||A||, and sensitivities this small count as equal and as
            zero. Take the accuracy of the model: 1e-8 for one that is written down, 1e-4 to 1e-3 for one that
            was identified.
        time_limit: seconds after which bounds are returned as they are.
        target: a count that is enough; 2 p + 1 to ask for p liars only.

    Raises:
        DesignError: the plant varies in time.
        InputError: cut or tol is not a number in its range.

    Notes:
        Noise that is correlated between sensors is taken as if it were not.

    Examples:
        >>> from securestate.plant import Plant, Sensor
        >>> sensors = [Sensor(name, C=[1, 0], R=1) for name in "abc"] + [Sensor("d", C=[1, 1], R=1)]
        >>> found = limit(Plant([[1, 0], [0, 1]], [[1, 0], [0, 1]], sensors))
        >>> found.max_attacked, found.weakest.sensors
        (0, ('d',))
    """
    if plant.time_varying:
        raise DesignError(
            "the limit needs a plant with constant A and C", "give the plant's value at one sample"
        )
    with np.errstate(over="ignore"):
        if not np.isfinite(np.square(plant.A).sum()):
            raise DesignError("A holds numbers whose squares overflow", "choose other units for the states")
    cut, tol = _number("cut", cut, 0.0, math.inf), _number("tol", tol, 0.0, 0.1)
    deadline = time.monotonic() + _number("time_limit", time_limit, 0.0, math.inf)
    X, found = noise_scaled(plant), []
    with one_blas_thread():
        spaces = eigenspaces(plant.A, X, cut, tol)
        for k, space in enumerate(spaces):
            share = max(0.0, deadline - time.monotonic()) / (len(spaces) - k)
            found.append(_mode_limit(plant, X, space, share, target))
    return Limit(plant, cut, tol, tuple(sorted(found, key=lambda m: (m.upper, m.lower, -abs(m.eigenvalue)))))


def relevant(plant: Plant, *, tol: float = TOLERANCE, time_limit: float = 60.0) -> Limit:
    """The limit over the modes that do not fade, |eigenvalue| >= 0.999; over all if every mode fades."""
    lasting = limit(plant, SLOW, tol=tol, time_limit=time_limit)
    return lasting if lasting.modes else limit(plant, 0.0, tol=tol, time_limit=time_limit)


def profile(plant: Plant, cut: float = SLOW, time_limit: float = 60.0) -> tuple[tuple[float, Limit], ...]:
    """The limit by tolerance: one that holds only for small ones rests on the digits of the model."""
    share = time_limit / len(TOLERANCES)
    return tuple((tol, limit(plant, cut, tol=tol, time_limit=share)) for tol in TOLERANCES)


def exposed(
    space: Eigenspace, seen: Sight, X: Array, owner: Indices, protected: NDArray[np.bool_]
) -> tuple[Eigenspace, Sight] | None:
    """What protected sensors do not see of an eigenspace, and how the others see that; None if it is nothing.

    Args:
        space, seen: the eigenspace and what all sensors see of it.
        X: (m, n), the sensors in units of their noise.
        owner: the sensor of every channel, (m,).
        protected: (N,).
    """
    if not protected.any():
        return space, seen
    basis = kernel_of(seen.rows[protected[seen.owner]], max(seen.blind, 1e-7))
    if not basis.shape[1]:
        return None
    part = space.within(basis)
    return part, sight(part, X, owner, len(protected)).only(~protected)


def _mode_limit(plant: Plant, X: Array, space: Eigenspace, time_limit: float, target: float) -> ModeLimit:
    seen = sight(space, X, plant.channel_sensor, plant.n_sensors)
    alone = np.bincount(seen.owner, minlength=plant.n_sensors) == space.multiplicity
    left = exposed(space, seen, X, plant.channel_sensor, plant.protected)
    if left is None:
        return ModeLimit(space, math.inf, math.inf, None, (), "protected", alone)
    part, seen = left
    count: Count = least_weight(seen, time_limit=time_limit, target=target)
    v = part.V @ count.direction
    return ModeLimit(
        space,
        count.lower,
        count.upper,
        mode_along(
            space.value, v.astype(np.complex128), plant.state_names, among_others=space.multiplicity > 1
        ),
        tuple(plant.sensor_names[i] for i in count.sensors),
        count.method,
        alone,
    )


def _number(argument: str, value: object, least: float, most: float) -> float:
    number = real_array(argument, value, InputError)
    if number.ndim or not least <= number <= most:
        expected = f"a number >= {least:g}" if math.isinf(most) else f"a number in {least:g}..{most:g}"
        raise InputError(argument, expected, repr(value))
    return float(number)
