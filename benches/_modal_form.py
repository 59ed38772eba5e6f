"""A mode-wise form of sparse fusion (li2021b), made of the kernel of `SparseFusion`, for `benches.modal`.

    G_i u = Σ_μ g(μ) C_i v_μ u_μ,    g(μ) = μ (μ I − T)⁻¹ b               each flat mode μ of A one coordinate
    f_i   = Σ_μ g(μ) a_iμ + D_i c_i,  D_iᵀ N_ii g(μ) = 0,  D_iᵀ N_ii D_i = I           the rest is one group
    min ½ fᵀ N f − ν₀ᵀ f + Σ γ_iμ |a_iμ| + Σ γ_i ‖c_i‖

With γ_iμ in proportion to 1 / |C_i v_μ| every sensor that sees a mode counts alike, whatever its noise: p
liars among the c sensors that see it have the ratio p / (c − p) of Theorem 4. A complex pair is one
coordinate of two elements under a 2-norm. Eigenvectors of one eigenvalue share a coordinate, with the norm
of C_i V_μ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc, gammaincinv

from securestate import Estimator, Plant, SparseFusion, _kernels
from securestate.estimators._sparse_design import RANK_TOLERANCE, Coordinates, kernel_design

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Group:
    """One penalty: sensor, mode (−1: the rest), ‖C_i V_μ‖, elements, largest variance of an element of ν₀."""

    sensor: int
    mode: int
    seen: float
    size: int
    variance: float


class Modal(Estimator):
    """The mode-wise form for scalar sensors.

    With `margin` the penalties of sensors that see a mode dimly are raised only so far that `liars` of them
    keep the ratio below it; the default raises all to the brightest, so that every sensor counts alike.
    """

    missing_limit, takes_covariance = 0.1, False

    def __init__(
        self,
        plant: Plant,
        *,
        refit: bool = True,
        liars: int = 1,
        margin: float = 0.0,
        probability: float = 0.95,
    ) -> None:
        self.parts = SparseFusion(plant).decomposition
        self.axes, self.groups = _axes(plant, self.parts)
        low, high = 0.5, 1 - 1e-12  # each group's share of the probability, by bisection
        for _ in range(60):
            middle = (low + high) / 2
            gammas = _gammas(self.groups, middle, liars, margin)
            low, high = (middle, high) if _kept(self.groups, gammas) < probability else (low, middle)
        gammas = _gammas(self.groups, high, liars, margin)
        design = kernel_design(plant, self.parts, self.axes, gammas, refit=refit)
        super().__init__(plant, _kernels.sparse_fusion(design), {"refit": refit, "margin": margin})

    @property
    def counts(self) -> list[int]:
        """How many sensors see each mode."""
        return list(np.bincount([g.mode for g in self.groups if g.mode >= 0]))


def flat_modes(parts: Any) -> list[tuple[complex, NDArray[np.complex128]]]:
    """Eigenvalue and eigenvectors, in flat coordinates, of A_u; one of each conjugate pair."""
    mu, w = np.linalg.eig(parts.split.A_u.astype(np.complex128))
    left = [j for j in np.argsort(-np.abs(mu), kind="stable") if mu[j].imag > -1e-9]
    found = []
    while left:
        same = [j for j in left if abs(mu[j] - mu[left[0]]) < 1e-7]
        found.append((complex(mu[left[0]]), np.linalg.qr(w[:, same])[0]))
        left = [j for j in left if j not in same]
    return found


def _axes(plant: Plant, parts: Any) -> tuple[Coordinates, list[Group]]:
    n, m = plant.n, plant.m
    each = [_sensor(plant, parts, i) for i in range(m)]
    S = [np.hstack(columns) for columns, _ in each]
    groups = [group for _, own in each for group in own]
    sensors = np.cumsum([0] + [s.shape[1] for s in S])
    whole = np.zeros((m * n, sensors[-1]))
    inverse = []
    for i, s in enumerate(S):
        rows = slice(i * n, (i + 1) * n)
        whole[rows, sensors[i] : sensors[i + 1]] = s
        N = parts.N[rows, rows]
        inverse.append(np.linalg.solve(s.T @ N @ s, s.T @ N))
    starts = np.cumsum([0] + [group.size for group in groups])
    H = whole.T @ parts.N @ whole
    return Coordinates(S, inverse, starts, sensors, np.arange(m + 1) * n, (H + H.T) / 2), groups


def _sensor(plant: Plant, parts: Any, i: int) -> tuple[list[Float], list[Group]]:
    """Columns of S_i, group by group: the modes that sensor i sees and another checks, then the rest."""
    n, T, b = plant.n, parts.pair.T, parts.pair.b
    N = parts.N[i * n : (i + 1) * n, i * n : (i + 1) * n]
    values, U = np.linalg.eigh(N)
    keep = values > RANK_TOLERANCE * parts.weights.precision[i, i]
    root = (U[:, keep] * np.sqrt(values[keep])).T
    columns: list[Float] = []
    groups = []
    for j, (mu, w) in enumerate(flat_modes(parts)):
        seen = float(np.linalg.norm(plant.C[i] @ parts.split.V[:, : len(w)] @ w))
        g = mu * np.linalg.solve(mu * np.eye(n) - T, b)
        block = np.stack([g.real, -g.imag], axis=1) if abs(mu.imag) > 1e-9 else g.real[:, np.newaxis]
        if seen < 1e-9 * np.linalg.norm(plant.C[i]) or np.linalg.norm(root @ block) < 1e-6:
            continue
        variances, turn = np.linalg.eigh(block.T @ N @ block)
        columns.append(block @ turn)
        groups.append(Group(i, j, seen, block.shape[1], float(variances[-1])))
    modes = np.hstack(columns) if columns else np.zeros((n, 0))
    Q, sizes, _ = np.linalg.svd(root @ modes, full_matrices=True)
    rest = (U[:, keep] / np.sqrt(values[keep])) @ Q[:, int(np.sum(sizes > 1e-9)) :]
    if rest.shape[1]:
        columns.append(rest)
        groups.append(Group(i, -1, 0.0, rest.shape[1], 1.0))
    return columns, groups


def _gammas(groups: list[Group], share: float, liars: int, margin: float) -> Float:
    """Quantiles of |ν₀| in every group, raised where a dim sensor has to count as much as a bright one."""
    gammas = np.array([np.sqrt(2 * gammaincinv(g.size / 2, share) * g.variance) for g in groups])
    modes, seen = np.array([g.mode for g in groups]), np.array([g.seen for g in groups])
    for mode in set(modes[modes >= 0]):
        at = modes == mode
        say = gammas[at] * seen[at]
        gammas[at] = np.maximum(say, _floor(say, liars, margin)) / seen[at]
    return gammas


def _floor(say: Float, liars: int, margin: float) -> float:
    """The smallest floor that keeps the `liars` with the most say below `margin` times that of the rest."""

    def ratio(floor: float) -> float:
        ordered = np.sort(np.maximum(say, floor))
        return float(ordered[-liars:].sum() / max(ordered[:-liars].sum(), 1e-300))

    low, high = 0.0, float(say.max())
    if ratio(high) >= margin:
        return high
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if ratio(middle) > margin else (low, middle)
    return high


def _kept(groups: list[Group], gammas: Float) -> float:
    """A bound of the probability that ν₀ stays within all penalties when nobody lies."""
    sizes, variances = np.array([(g.size, g.variance) for g in groups]).T
    return float(1 - gammaincc(sizes / 2, gammas**2 / variances / 2).sum())
