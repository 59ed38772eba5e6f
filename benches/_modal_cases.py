"""Plants, lies and margins for `benches.modal`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import gammaincinv

from benches._modal_form import flat_modes
from securestate import Plant, Sensor

Float = NDArray[np.float64]
LIU_C = ((1, 0, 0), (1, 1, -1), (1, 2, 1), (1, -1, -0.5), (-0.5, 1, 1))


def liu() -> Plant:
    """Section VI of liu2020. Its eigenvalue 1 has two eigenvectors, so that counting proves nothing there."""
    return plant_of(np.diag([1.0, 1.0, -2.0]), np.array(LIU_C, float), np.ones(5), 1.0)


def plant_of(A: Float, C: Float, R: Float, Q: float) -> Plant:
    """With an input for every state, which keeps the plant bounded."""
    sensors = [Sensor(f"s{i}", C=row, R=r) for i, (row, r) in enumerate(zip(C, R, strict=True))]
    return Plant(A, Q * np.eye(len(A)), sensors, B=np.eye(len(A)))


def random_plant(rng: np.random.Generator) -> Plant:
    """Distinct modes, most of them flat, and sensors whose noise differs by up to 100 in variance."""
    while True:
        n = int(rng.integers(2, 6))
        N = int(rng.integers(5, 13))
        blocks: list[Float] = []
        while (left := n - sum(len(b) for b in blocks)) > 0:
            if left > 1 and rng.random() < 0.4:
                r, t = rng.uniform(1, 1.1), rng.uniform(0.3, 2.8)
                blocks.append(r * np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]))
            else:
                size = rng.uniform(1, 1.15) if rng.random() < 0.7 else rng.uniform(0.1, 0.9)
                blocks.append(np.array([[rng.choice([-1, 1]) * size]]))
        X = rng.standard_normal((n, n))
        C = rng.standard_normal((N, n)) * (rng.random((N, n)) < 0.7)
        R = 10 ** rng.uniform(-1, 1, N)
        mu = np.linalg.eigvals(block_diag(*blocks))
        flat = mu[np.abs(mu) >= 0.999]
        distinct = min((abs(a - b) for a, b in combinations(flat, 2)), default=1.0) > 0.05
        if len(flat) and distinct and np.linalg.cond(X) < 20 and C.any(axis=1).all():
            return plant_of(X @ block_diag(*blocks) @ np.linalg.inv(X), C, R, 0.3)


def ordinary(n: int, N: int) -> Plant:
    rng = np.random.default_rng([n, N])
    A = {
        2: np.array([[1.0, 1.0], [0.0, 0.95]]),
        4: np.diag([1.02, 1.0, -0.9, 0.7]) + np.triu(0.3 * rng.standard_normal((4, 4)), 1),
    }[n]
    return plant_of(A, rng.standard_normal((N, n)), rng.uniform(0.5, 2, N), 0.1)


def squares(plant: Plant, parts: Any) -> Float:
    """‖G_i u‖² in the metric N_ii as matrices, (m, n_u, n_u)."""
    n = plant.n
    N = [parts.N[i * n : (i + 1) * n, i * n : (i + 1) * n] for i in range(plant.m)]
    return np.stack([G.T @ N_ii @ G for G, N_ii in zip(parts.G, N, strict=True)])


def modal_ratio(plant: Plant, parts: Any, liars: int) -> float:
    """Theorem 4 for the mode-wise form: p / (c − p); on a grid where a real mode has two eigenvectors."""
    ratios = []
    for _, w in flat_modes(parts):
        X = plant.C @ parts.split.V[:, : len(w)] @ w
        size = np.linalg.norm(X, axis=1)
        X = X[size > 1e-9] / size[size > 1e-9, np.newaxis]
        angle = np.linspace(0, np.pi, 20001)
        grid = np.stack([np.cos(angle), np.sin(angle)]) if X.shape[1] == 2 else np.ones((1, 1))
        say = np.sort(np.abs(X @ grid), axis=0)[::-1]
        ratios.append(np.max(say[:liars].sum(axis=0) / say[liars:].sum(axis=0)))
    return float(max(ratios))


def worst(plant: Plant, parts: Any, liars: int, weights: Float | float = 1.0) -> tuple[float, Float, Float]:
    """Theorem 4 for penalties per sensor: the ratio (a lower bound, by ascent), its direction u, and ‖G_i u‖.

    The share of the liars with the most is convex over convex; a step solves it with the total replaced by
    the quadratic that touches it.
    """
    rng, Q = np.random.default_rng(liars), squares(plant, parts)
    Q *= np.square(np.broadcast_to(weights, plant.m))[:, np.newaxis, np.newaxis]
    best = (0.0, np.zeros(0), np.zeros(0))
    for _ in range(60):
        u, share = rng.standard_normal(Q.shape[1]), -1.0
        for _ in range(40):
            size = np.sqrt(np.maximum(np.einsum("a,iab,b->i", u, Q, u), 1e-24))
            most = np.argsort(-size)[:liars]
            now = size[most].sum() / size.sum()
            if now > best[0]:
                best = (now, u, size)
            if now <= share + 1e-9:
                break
            share = now
            u = np.linalg.solve(np.einsum("i,iab->ab", 1 / size, Q), (Q[most] @ u / size[most, None]).sum(0))
            u /= np.linalg.norm(u)
    return best[0] / (1 - best[0]), best[1], best[2]


def evened(plant: Plant, parts: Any) -> Float:
    """Penalties per sensor in proportion to 1 / ‖G_i‖ in the metric N_ii, flat modes scaled alike."""
    Q = squares(plant, parts)
    say = np.sqrt(np.einsum("iab,ba->i", Q, np.linalg.inv(Q.sum(axis=0))))
    quantile = np.sqrt(2 * gammaincinv(plant.n / 2, 0.95 ** (1 / plant.m)))
    return np.asarray(quantile * say.max() / say)


def moving(plant: Plant, parts: Any, liars: NDArray[np.int64], u: Float, steps: int) -> Float:
    """C_I V_u A_u^(k − last) u of the liars, (T, m); the largest last reading is one standard deviation."""
    d = [u]
    while len(d) < steps:
        d.append(np.linalg.solve(parts.split.A_u, d[-1]))
    a = np.array(d[::-1]) @ (plant.C @ parts.split.V[:, : len(u)]).T
    a[:, np.setdiff1d(np.arange(plant.m), liars)] = 0
    return np.asarray(a / np.max(np.abs(a[-1]) / np.sqrt(np.diag(plant.R))))


def lies(
    plant: Plant, parts: Any, p: int, found: tuple[float, Float, Float], rng: np.random.Generator
) -> Iterator[tuple[str, NDArray[np.int64], Float]]:
    """Who lies, and the direction in which: the default's worst, along the largest mode, at random."""
    w = flat_modes(parts)[0][1][:, 0].real
    seen = np.abs(plant.C @ parts.split.V[:, : len(w)] @ w) / np.sqrt(np.diag(plant.R))
    yield "worst for the default", np.argsort(-found[2])[:p], found[1]
    yield "brightest along a mode", np.argsort(-seen)[:p], w
    yield "dimmest along a mode", np.argsort(np.where(seen > 1e-6, seen, np.inf))[:p], w
    yield "random", rng.permutation(plant.m)[:p], rng.standard_normal(len(w))
