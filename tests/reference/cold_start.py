"""Generalised least squares over a window as in a textbook: every noise a column of its own. Slow."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from securestate import Plant

Array = NDArray[np.float64]


def window_states(plant: Plant, y: Array, u: Array, believed: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Smoothed states (T, n) and covariances (T, n, n) from the believed readings of y (T, m), file units.

    Unknowns are x[0] and all w[k]; x[k] is a linear map of them plus what the inputs do.
    """
    T, n = len(y), plant.n
    maps, offset = np.zeros((T, n, n * T)), np.zeros((T, n))
    maps[0, :, :n] = np.eye(n)
    ut = (u - plant.input_offset) / plant.input_scale
    for k in range(T - 1):
        A = plant.A[k] if plant.A.ndim == 3 else plant.A
        maps[k + 1] = A @ maps[k]
        maps[k + 1][:, (k + 1) * n : (k + 2) * n] += np.eye(n)
        offset[k + 1] = A @ offset[k] + plant.B @ ut[k]
    C = [plant.C[k] if plant.C.ndim == 3 else plant.C for k in range(T)]
    H = np.vstack([C[k] @ maps[k] for k in range(T)])
    z = np.concatenate(
        [(y[k] - plant.offset) / plant.scale - C[k] @ offset[k] - plant.D @ ut[k] for k in range(T)]
    )
    use = (believed & ~np.isnan(y)).ravel()
    Q, R = block_diag(*[plant.Q] * (T - 1)) if T > 1 else np.zeros((0, 0)), block_diag(*[plant.R] * T)
    O, G = H[:, :n], H[:, n:]
    Sigma = (R + G @ Q @ G.T)[np.ix_(use, use)]
    inverse = np.linalg.inv(Sigma)
    P0 = np.linalg.inv(O[use].T @ inverse @ O[use])
    x0 = P0 @ O[use].T @ inverse @ z[use]
    gain = Q @ G[use].T @ inverse
    w = gain @ (z[use] - O[use] @ x0)
    top = np.hstack([P0, -P0 @ O[use].T @ gain.T])
    low = np.hstack([top[:, n:].T, Q - gain @ G[use] @ Q + gain @ O[use] @ P0 @ O[use].T @ gain.T])
    P = np.vstack([top, low])
    unknowns = np.concatenate([x0, w])
    return offset + maps @ unknowns, maps @ P @ np.swapaxes(maps, 1, 2)
