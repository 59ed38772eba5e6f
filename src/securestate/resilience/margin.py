"""How little the honest sensors see of the lie that suits the attacked ones best.

The attacked sensors can tell that the state is x + v, v along a mode of the plant, and the lie looks like the
plant's own motion. All sensors together would see ||X v|| standard deviations of it, X_i = R_i^-1/2 C_i, the
honest ones see only their rows of X v. The margin is the smallest share that they see:

    eta = min over modes lambda and v in ker(A - lambda I) of ||X_honest v|| / ||X v||

It has no unit, is 0 if and only if a mode is hidden from the honest sensors, and 1 if nobody is attacked.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate.errors import DesignError, InputError
from securestate.plant import Plant
from securestate.resilience.detectability import RANK, Array, Complex, Mode, mode_along, modes

#: A mode of at least this size counts as one that does not fade.
SLOW = 0.999


@final
@dataclass(frozen=True, eq=False)
class Margin:
    """The lie that the honest sensors see least.

    Attributes:
        eta: share of it that they see, in [0, 1].
        mode: its eigenvalue and direction v, a unit vector.
        seen: ||X v||, what all sensors together see of v, in standard deviations of their noise.
    """

    eta: float
    mode: Mode
    seen: float

    def __str__(self) -> str:
        return f"{self.mode}: the honest sensors see {self.eta:.3g} of a lie along it"


def margin(plant: Plant, attacked: Iterable[int], cut: float = SLOW) -> Margin:
    """Find the lie that shows least in the sensors that are not attacked.

    Args:
        attacked: sensors, counted from 0.
        cut: only modes with |eigenvalue| >= cut count; all modes if none is that large. Of equal margins the
            one of the largest eigenvalue is returned.

    Raises:
        DesignError: the plant varies in time, or no sensor at all sees the modes that count.
        InputError: there is no such sensor, or cut is not a number >= 0.

    Notes:
        Noise that is correlated between sensors is taken as if it were not.
        Modes that no sensor sees at all do not count: they are lost without any lie.

    Examples:
        >>> from securestate.plant import Sensor
        >>> sensors = [Sensor("a", C=[1, 0], R=1), Sensor("b", C=[3, 0], R=1), Sensor("c", C=[0, 1], R=1)]
        >>> plant = Plant([[1, 0], [0, 0.5]], [[1, 0], [0, 1]], sensors)
        >>> print(margin(plant, [1]))     # sensor a sees 1 of sqrt(1 + 9)
        mode 1 (x1): the honest sensors see 0.316 of a lie along it
    """
    rows = _honest_rows(plant, attacked)
    X = noise_scaled(plant)
    found = modes(plant, cut) or modes(plant, 0.0)
    spaces = [list(group) for _, group in groupby(found, key=lambda mode: mode.eigenvalue)]
    each = [m for space in spaces if (m := _least_seen(plant, X, rows, space)) is not None]
    if not each:
        raise DesignError("no sensor sees any mode that counts", "add a sensor that depends on it")
    return min(each, key=lambda m: m.eta)


def noise_scaled(plant: Plant) -> Array:
    """X with X_i = R_i^-1/2 C_i, (m, n): every sensor in standard deviations of its noise."""
    X = plant.C / np.sqrt(np.diag(plant.R))[:, None]
    counts = np.bincount(plant.channel_sensor, minlength=plant.n_sensors)
    for i in np.flatnonzero(counts > 1):
        own = plant.channels_of(int(i))
        X[own] = np.linalg.solve(np.linalg.cholesky(plant.R[own, own]), plant.C[own])
    return X


def _honest_rows(plant: Plant, attacked: Iterable[int]) -> NDArray[np.intp]:
    """Channels of the sensors that are not attacked."""
    lying = set(attacked)
    for i in lying:
        if not 0 <= i < plant.n_sensors:
            raise InputError("attacked", f"indices in 0..{plant.n_sensors - 1}", str(i))
    return np.flatnonzero([owner not in lying for owner in plant.channel_sensor])


def _least_seen(plant: Plant, X: Array, honest: NDArray[np.intp], space: list[Mode]) -> Margin | None:
    """The direction in one eigenspace that the honest rows see least; None if no row sees any of it."""
    V = np.stack([mode.direction for mode in space], axis=1)
    shown = X @ (V if space[0].eigenvalue.imag else V.real)
    U, sizes, Wh = np.linalg.svd(shown, full_matrices=False)
    seen = sizes > RANK * max(np.linalg.norm(X, 2), np.finfo(np.float64).tiny)
    if not seen.any():
        return None
    U, back = U[:, seen], Wh[seen].conj().T / sizes[seen]
    eta, z = _smallest(U[honest])
    v: Complex = V @ (back @ z)
    length = float(np.linalg.norm(v))
    return Margin(eta, mode_along(space[0].eigenvalue, v, plant.state_names), 1.0 / length)


def _smallest(rows: Complex) -> tuple[float, Complex]:
    """The smallest singular value, 0 if it is mere rounding, and its right singular vector."""
    _, sizes, Vh = np.linalg.svd(np.vstack([rows, np.zeros((rows.shape[1], rows.shape[1]))]))
    smallest = float(min(sizes[-1], 1.0))
    return (smallest if smallest > RANK else 0.0), Vh[-1].conj()
