"""One steady-state Kalman filter per sensor, each on the part of the state that its sensor can see.

    z_i = T_i x
    z_i[k|k] = z_i[k|k-1] + K_i (y_i - C_i z_i[k|k-1] - D_i u),   z_i[k+1|k] = A_i z_i[k|k] + B_i u

The rows of T_i are an orthonormal basis of what sensor i observes, so that the filter exists even if a mode
that the sensor does not see never decays. Where the sensor sees every mode, T_i is square.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate._steady_state import steady_state
from securestate.errors import DesignError
from securestate.plant import Plant, Sensor

Array = NDArray[np.float64]

#: Part of A' v outside the known directions, relative to the norm of A, that counts as a new direction.
NEW = 1e-9


@final
@dataclass(frozen=True)
class LocalFilter:
    """The filter of one sensor in normalised units, with m_i channels and n_i <= n modes.

    Attributes:
        T: (n_i, n), orthonormal rows, z = T x.
        A: (n_i, n_i). B: (n_i, p). C: (m_i, n_i). D: (m_i, p).
        gain: K (n_i, m_i).
        innovation_cov: S (m_i, m_i) in steady state when the sensor is honest.
    """

    T: Array
    A: Array
    B: Array
    C: Array
    D: Array
    gain: Array
    innovation_cov: Array


def local_filters(plant: Plant, sensors: Iterable[int] | None = None) -> tuple[LocalFilter, ...]:
    """Design the filter of every sensor on its own, or of the given ones (indices from 0).

    Raises:
        DesignError: the plant varies in time, or a sensor has no steady-state filter; names it.

    Examples:
        >>> a, b = Sensor("a", C=[1.0, 0.0], R=4.0), Sensor("b", C=[0.0, 1.0], R=1.0)
        >>> filters = local_filters(Plant([[1.0, 0.0], [0.0, 2.0]], [[2.0, 0.0], [0.0, 1.0]], [a, b]))
        >>> print(filters[0].T, filters[0].gain)
        [[ 1. -0.]] [[0.5]]
    """
    if plant.time_varying:
        raise DesignError("local steady-state filters need a time-invariant plant", "give constant A and C")
    return tuple(_local_filter(plant, i) for i in (range(plant.n_sensors) if sensors is None else sensors))


def _local_filter(plant: Plant, sensor: int) -> LocalFilter:
    own = plant.channels_of(sensor)
    C, R = plant.C[own], plant.R[own, own]
    T = observable_basis(plant.A, C)
    A, seen = T @ plant.A @ T.T, C @ T.T
    Q = T @ plant.Q @ T.T
    name = plant.sensor_names[sensor]
    try:
        steady = steady_state(Plant(A, (Q + Q.T) / 2, [Sensor(name, C=seen, R=R)]))
    except DesignError as refusal:
        raise DesignError(
            f"sensor {name!r} has no steady-state filter of its own: {refusal.reason}", refusal.advice
        ) from None
    return LocalFilter(T, A, T @ plant.B, seen, plant.D[own], steady.gain, steady.innovation_cov)


def observable_basis(A: Array, C: Array) -> Array:
    """Orthonormal rows (n_i, n) that span what C sees of x[k+1] = A x[k]: the rows of C, C A, C A^2, ..."""
    basis = _directions(C.T, float(np.linalg.norm(C, 2)))
    size = max(1.0, float(np.linalg.norm(A, 2)))
    newest = basis
    while newest.shape[1] and basis.shape[1] < len(A):
        moved = A.T @ newest
        newest = _directions(moved - basis @ (basis.T @ moved), size)
        basis = np.asarray(linalg.qr(np.hstack([basis, newest]), mode="economic")[0], dtype=np.float64)
    return basis.T


def _directions(columns: Array, size: float) -> Array:
    """Orthonormal columns that span those directions of `columns` that are not mere rounding of `size`."""
    U, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, sizes > NEW * size], dtype=np.float64)
