"""What follows from the plant alone: the decomposition (Section III and IV) and what sensors can survive."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from papers._report import Value
from papers.liu2020.setting import Setting
from securestate import SparseFusion
from securestate.resilience import undetectable_modes


def decomposition(setting: Setting, printed: dict[str, list[Any]]) -> dict[str, Value]:
    """Distance from every printed digit of Section VI, and the identities of Theorems 1 and 2."""
    paper = setting.paper(1.0).decomposition
    robust = SparseFusion(setting.plant).decomposition
    steady = paper.steady
    ours = {"K": steady.gain, "P": steady.P_posterior, "eigenvalues": np.diag(paper.pair.T), "G": paper.G}
    distances = {
        f"printed.{name}": Value(float(np.abs(np.asarray(printed[name]) - value).max()))
        for name, value in ours.items()
    }
    total = np.einsum("iab,ibc->ac", paper.F, paper.G)
    return distances | {
        "trace": Value(setting.trace),
        "sum F G": Value(float(np.abs(total - np.eye(setting.plant.n)).max())),
        "theorem 2": Value(_least_squares_distance(paper.G, paper.F, paper.W)),
        "condition.paper": Value(float(np.linalg.cond(paper.W))),
        "condition.robust": Value(float(np.linalg.cond(robust.W))),
    }


def _least_squares_distance(G: np.ndarray, F: np.ndarray, W: np.ndarray) -> float:
    """Distance of [F_1 ... F_m] from the matrix (Gᵀ W⁻¹ G)⁻¹ Gᵀ W⁻¹ of the least squares (30)."""
    stacked = G.reshape(-1, G.shape[2])
    weighted = np.linalg.solve(W, stacked)
    fit = np.linalg.solve(stacked.T @ weighted, weighted.T)
    return float(np.abs(fit - np.hstack(F)).max())


def observability(setting: Setting) -> dict[str, Value]:
    """Which sensors see the whole state alone, and how many liars any estimator at all can survive.

    No mode of this plant fades, so that detectable and observable mean the same.
    """
    plant = setting.plant
    alone = [not undetectable_modes(plant.select([i])) for i in range(plant.n_sensors)]
    removable = 0
    while removable < plant.n_sensors - 1 and all(
        not undetectable_modes(plant.select(kept))
        for kept in combinations(range(plant.n_sensors), plant.n_sensors - removable - 1)
    ):
        removable += 1
    return {
        "sensor 1 sees all": Value(float(alone[0])),
        "sensors that see all": Value(float(sum(alone))),
        "liars at most": Value(float(removable // 2)),
    }
