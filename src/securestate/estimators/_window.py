"""What the first samples say about the first state: y = O x0 + G w + v + a, in the letters of the cold start.

    x[k] = xi[k] + Phi[k] x0 + (noise of the process up to k),   Cov = V[k]
    y[k] - C xi[k] - D ut[k] = C Phi[k] x0 + noise,              O = (C Phi[k]),  Sigma = R + G Q G'

xi is the known response of the plant to its inputs from the state zero. Rows are readings, sample after
sample.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from securestate.plant import Plant

Float = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Window:
    """The model of `tau` samples; rows of O and Sigma are all m channels of sample 0, then of sample 1, ...

    Attributes:
        Phi: (tau, n, n), from x0 to x[k]. V: (tau, n, n), what the process noise adds to x[k].
        O: (tau m, n). Sigma: (tau m, tau m).
    """

    plant: Plant
    tau: int
    Phi: Float
    V: Float
    O: Float
    Sigma: Float

    @property
    def finite(self) -> bool:
        """Whether no number of the model is beyond all numbers."""
        return all(np.isfinite(part).all() for part in (self.Phi, self.V, self.O, self.Sigma))

    def crosses(self) -> Iterator[Float]:
        """Cov(x[k], y) given x0 for every sample in turn, (n, tau m)."""
        return _crosses(self.plant, self.tau, self.O)


def window_model(plant: Plant, tau: int) -> Window:
    """The model of the first `tau` samples of a plant, in normalised units."""
    n, m = plant.n, plant.m
    Phi, V = np.empty((tau, n, n)), np.empty((tau, n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        Phi[0], V[0] = np.eye(n), 0.0
        for k in range(tau - 1):
            Phi[k + 1] = at(plant.A, k) @ Phi[k]
            V[k + 1] = at(plant.A, k) @ V[k] @ at(plant.A, k).T + plant.Q
        C = plant.C[:tau] if plant.C.ndim == 3 else plant.C
        O = (C @ Phi).reshape(tau * m, n)
        Sigma = np.empty((tau * m, tau * m))
        for k, cross in enumerate(_crosses(plant, tau, O)):
            own = slice(k * m, (k + 1) * m)
            Sigma[own] = at(plant.C, k) @ cross
            Sigma[own, own] += plant.R
    return Window(plant, tau, Phi, V, O, Sigma / 2 + Sigma.T / 2)


def _crosses(plant: Plant, tau: int, O: Float) -> Iterator[Float]:
    """X[k] = Cov(x[k], y) by X[k+1] = A X[k] + Q T', T = how later readings see the noise w[k]."""
    m, cross = plant.m, np.zeros((plant.n, tau * plant.m))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(tau):
            yield cross
            cross = at(plant.A, k) @ cross
            if k + 1 < tau:
                cross[:, (k + 1) * m :] += plant.Q @ _seen_from(plant, k + 1, tau, O).T


def _seen_from(plant: Plant, first: int, tau: int, O: Float) -> Float:
    """How the samples from `first` on see x[first], ((tau - first) m, n)."""
    if not plant.time_varying:
        return O[: (tau - first) * plant.m]
    moved, blocks = np.eye(plant.n), []
    for k in range(first, tau):
        blocks.append(at(plant.C, k) @ moved)
        moved = at(plant.A, k) @ moved
    return np.vstack(blocks)


def at(matrix: Float, k: int) -> Float:
    """The matrix at sample k, whether it varies in time or not; a plant's last one lasts."""
    return matrix[min(k, len(matrix) - 1)] if matrix.ndim == 3 else matrix


def known_response(plant: Plant, u: Float) -> tuple[Float, Float]:
    """Return xi (tau + 1, n) and the readings (tau, m) it makes; u (tau, p) in file units."""
    ut, xi = plant.normalise_input(u), np.zeros((len(u) + 1, plant.n))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(u)):
            xi[k + 1] = at(plant.A, k) @ xi[k] + plant.B @ ut[k]
        C = plant.C[: len(u)] if plant.C.ndim == 3 else plant.C
        return xi, np.einsum("...ij,...j->...i", C, xi[:-1]) + ut @ plant.D.T
