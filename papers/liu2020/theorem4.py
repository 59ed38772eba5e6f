"""Theorem 4: p liars cannot move the estimate without bound if, for every set I of p sensors and every u ≠ 0,

    Σ_{i in I} ‖G_i u‖ < Σ_{i not in I} ‖G_i u‖.

ρ(I) is the largest ratio of the two sides over u; the condition is ρ < 1. The norm is that of the penalty.
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize

from papers._report import Value
from papers.liu2020.setting import Setting
from securestate import SparseFusion

Float = NDArray[np.float64]
#: Directions of the grid from which the local search starts.
STARTS = 3


def ratios(setting: Setting) -> dict[str, Value]:
    """ρ for every single sensor, and for the worst pair, of both forms."""
    paper = setting.paper(1.0).decomposition.G
    robust = weighted_maps(SparseFusion(setting.plant))
    directions = sphere(setting.scale["grid"])
    norms = _norms(robust, directions)
    found = {}
    for sensor in range(setting.plant.n_sensors):
        found[f"rho.paper.{sensor + 1}"] = Value(l1_ratio(paper, (sensor,)))
        found[f"rho.robust.{sensor + 1}"] = Value(group_ratio(robust, (sensor,), directions, norms))
    pairs = list(combinations(range(setting.plant.n_sensors), 2))
    found["rho.paper.pair"] = Value(max(l1_ratio(paper, pair) for pair in pairs))
    found["rho.robust.pair"] = Value(max(group_ratio(robust, pair, directions, norms) for pair in pairs))
    return found


def l1_ratio(G: Float, inside: tuple[int, ...]) -> float:
    """ρ(I) in the 1-norm, exactly: one linear programme per sign pattern of the stacked G_i u, i in I.

    max s·(G_I u) subject to |G_j u| ≤ t row by row for j not in I, Σ t ≤ 1; s and −s give the same.
    """
    n = G.shape[2]
    top = G[list(inside)].reshape(-1, n)
    top = top[np.abs(top).max(axis=1) > 0]
    rest = np.delete(G, list(inside), axis=0).reshape(-1, n)
    rows = len(rest)
    limits = np.block([[rest, -np.eye(rows)], [-rest, -np.eye(rows)], [np.zeros((1, n)), np.ones((1, rows))]])
    bounds = [(None, None)] * n + [(0, None)] * rows
    best = 0.0
    for signs in product((1.0, -1.0), repeat=len(top) - 1):
        cost = np.concatenate([-np.array([1.0, *signs]) @ top, np.zeros(rows)])
        solved = linprog(cost, limits, np.append(np.zeros(2 * rows), 1.0), bounds=bounds, method="highs")
        if solved.status == 3:  # unbounded: the other sensors do not see some u
            return float("inf")
        best = max(best, -solved.fun)
    return best


def weighted_maps(estimator: SparseFusion) -> Float:
    """H_i = N_ii^{1/2} G_i: the norm of G_i u in the metric N_ii of the robust form is ‖H_i u‖₂."""
    parts, n = estimator.decomposition, estimator.plant.n
    maps = []
    for i, G_i in enumerate(parts.G):
        values, vectors = np.linalg.eigh(parts.N[i * n : (i + 1) * n, i * n : (i + 1) * n])
        maps.append((np.sqrt(np.maximum(values, 0))[:, np.newaxis] * vectors.T) @ G_i)
    return np.stack(maps)


def sphere(count: int) -> Float:
    """Directions u of three states, one of each pair ±u, on a grid of angles; shape (2 count², 3)."""
    theta, phi = np.linspace(0, np.pi, count)[:, np.newaxis], np.linspace(0, np.pi, 2 * count)
    return _direction(theta, phi).reshape(-1, 3)


def _direction(theta: Float, phi: Float) -> Float:
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], axis=-1
    )


def _norms(H: Float, u: Float) -> Float:
    """‖H_i u‖₂ of every sensor, (..., m) for u (..., n)."""
    return np.sqrt(
        np.sum((u @ H.reshape(-1, H.shape[2]).T).reshape(*u.shape[:-1], *H.shape[:2]) ** 2, axis=-1)
    )


def _share(norms: Float, inside: tuple[int, ...]) -> Float:
    top = norms[..., list(inside)].sum(axis=-1)
    return top / (norms.sum(axis=-1) - top)


def group_ratio(H: Float, inside: tuple[int, ...], directions: Float, norms: Float) -> float:
    """ρ(I) in the norm ‖H_i u‖₂: the best grid directions, each improved by a local search."""
    values = _share(norms, inside)
    best = float(values.max())
    options = {"xatol": 1e-10, "fatol": 1e-13}
    for start in directions[np.argsort(values)[-STARTS:]]:
        solved = minimize(
            lambda u: -float(_share(_norms(H, u), inside)), start, method="Nelder-Mead", options=options
        )
        best = max(best, -solved.fun)
    return best
