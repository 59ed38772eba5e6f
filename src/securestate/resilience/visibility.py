"""Who sees what, and how strongly: modes by sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate.resilience.detectability import Mode, mode_along, readable
from securestate.resilience.eigenspaces import Array
from securestate.resilience.limit import Limit, ModeLimit
from securestate.resilience.margin import noise_scaled

#: Cosine of the angle between two directions that are shown as one.
ALIKE = 1 - 1e-9


@final
@dataclass(frozen=True, eq=False)
class Visibility:
    """One row per mode: of every eigenspace the direction that fewest sensors see, then a basis.

    Attributes:
        modes: M directions, those seen by fewest sensors first.
        share: (M, N), ||R_i^-1/2 C_i v|| over what all sensors together see of v, in [0, 1]; 0 if it is
            blind.
        sees: (M, N) booleans: not blind.
        protected: (N,) booleans.
    """

    modes: tuple[Mode, ...]
    share: Array
    sees: NDArray[np.bool_]
    protected: NDArray[np.bool_]

    @property
    def count(self) -> NDArray[np.int64]:
        """(M,): how many sensors that may lie see the direction."""
        counts: NDArray[np.int64] = (self.sees & ~self.protected).sum(axis=1)
        return counts

    @property
    def survives(self) -> NDArray[np.int64]:
        """(M,): liars that the direction survives; all that may lie if a protected sensor sees it."""
        safe = (self.sees & self.protected).any(axis=1)
        free = int((~self.protected).sum())
        survives: NDArray[np.int64] = np.where(safe, free, np.minimum(free, (self.count - 1) // 2))
        return survives


def visibility(found: Limit) -> Visibility:
    """Who sees the modes of a limit."""
    plant = found.plant
    X = noise_scaled(plant)
    spaces = [(direction, mode) for mode in found.modes for direction in _directions(mode, plant.state_names)]
    rows = [_row(X, plant.channel_sensor, plant.n_sensors, mode, v.direction) for v, mode in spaces]
    share = np.array([row for row, _ in rows]).reshape(len(rows), plant.n_sensors)
    sees = np.array([seen for _, seen in rows], dtype=bool).reshape(share.shape)
    unsorted = Visibility(tuple(v for v, _ in spaces), share, sees, plant.protected)
    order = np.lexsort((unsorted.count, unsorted.survives))
    return Visibility(tuple(unsorted.modes[k] for k in order), share[order], sees[order], plant.protected)


def _directions(mode: ModeLimit, names: tuple[str, ...]) -> list[Mode]:
    """The direction that fewest see, and a basis of the eigenspace, every one with a state of its own."""
    found = [] if mode.mode is None else [mode.mode]
    V = mode.space.V.T.astype(np.complex128)
    for v in readable(V):
        if not any(abs(np.vdot(other.direction, v)) >= ALIKE for other in found):
            found.append(mode_along(mode.eigenvalue, v, names, among_others=mode.multiplicity > 1))
    return found


def _row(
    X: Array, owner: NDArray[np.int64], sensors: int, mode: ModeLimit, v: NDArray[np.complex128]
) -> tuple[Array, NDArray[np.bool_]]:
    seen = np.zeros(sensors)
    np.add.at(seen, owner, np.abs(X @ v) ** 2)
    loud = np.zeros(sensors)
    np.add.at(loud, owner, ((X * mode.space.scale) ** 2).sum(axis=1))
    length = float(np.linalg.norm(v / mode.space.scale))
    sees = np.sqrt(seen) > mode.space.blind * np.sqrt(loud) * length
    total = float(np.sqrt(seen.sum()))
    return (np.sqrt(seen) / total if total else seen) * sees, sees
