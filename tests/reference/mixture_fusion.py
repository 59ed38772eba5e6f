"""Algorithm 1 of Zhu et al. 2022 as in a textbook: dense matrices, inverses, nothing cached. Slow.

What the paper leaves open is as `MixtureFusion` documents it.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from securestate import Plant

Array = NDArray[np.float64]


@dataclass
class Textbook:
    """Per sample: x (T, n), P (T, n, n), trust (T, N), attack (T, m), and numbers by name (T,)."""

    x: Array
    P: Array
    trust: Array
    attack: Array
    diagnostics: dict[str, Array]


@dataclass
class Fit:
    """Beliefs gamma1 (N,), the log-likelihood after every expectation step, and whether it settled."""

    gamma: Array
    likelihoods: list[float] = field(default_factory=list)
    gap: float = np.inf


def fit(
    X: Array,
    P: Array,
    prediction: Array,
    *,
    init: str = "split",
    mean: str = "printed",
    floor: str = "printed",
    cap: int = 100,
) -> Fit:
    """(15)-(19) on points X (N, n) with the covariances P (N, n, n) of the first component."""
    N, n = X.shape
    pi = np.array([0.5, 0.5])
    mu1, mu2, Sigma2 = start(X, prediction, init)
    added = np.diag(np.mean([np.diag(one) for one in P], axis=0))
    result = Fit(np.ones(N))
    for _ in range(cap):
        low = added if floor == "prior" else 1e-9 * max(1.0, np.trace(Sigma2)) * np.eye(n)
        first = np.log(max(pi[0], 1e-300)) + log_normal(X, mu1, P)
        second = np.log(max(pi[1], 1e-300)) + log_normal(X, mu2, (Sigma2 + low)[None])
        both = np.logaddexp(first, second)
        gamma, attacked = np.exp(first - both), np.exp(second - both)
        before = result.likelihoods[-1] if result.likelihoods else -np.inf
        result.gamma = gamma
        result.likelihoods.append(float(both.sum()))
        result.gap = abs(result.likelihoods[-1] - before) / (1 + abs(result.likelihoods[-1]))
        if result.gap < 1e-6:
            break
        pi = np.array([gamma.mean(), attacked.mean()])
        if gamma.sum() > 1e-12:
            W = np.array([np.linalg.inv(one) if mean == "precision" else np.eye(n) for one in P])
            total = np.einsum("i,iab->ab", gamma, W)
            mu1 = np.linalg.solve(total, np.einsum("i,iab,ib->a", gamma, W, X))
        if attacked.sum() > 1e-12:
            mu2 = attacked @ X / attacked.sum()
            Sigma2 = (attacked[:, None] * (X - mu2)).T @ (X - mu2) / attacked.sum()
    return result


def start(X: Array, prediction: Array, init: str) -> tuple[Array, Array, Array]:
    """Where mu1, mu2 and Sigma2 begin."""
    centre = X.mean(axis=0)
    Sigma2 = (X - centre).T @ (X - centre) / len(X)
    if init == "split":
        sizes, axes = np.linalg.eigh(Sigma2)
        axis = axes[:, -1] * np.sign(axes[np.abs(axes[:, -1]).argmax(), -1])
        step = np.sqrt(max(sizes[-1], 0.0)) * axis
        return centre - step, centre + step, Sigma2
    first = {"median": np.median(X, axis=0), "mean": centre, "prediction": prediction}[init]
    return first, centre, Sigma2


def log_normal(X: Array, mean: Array, cov: Array) -> Array:
    """Of points X (N, n), with one covariance (1, n, n) or one each."""
    d = X - mean
    squares = np.sum(d * np.linalg.solve(cov, d[:, :, None])[:, :, 0], axis=1)
    return np.asarray(-0.5 * (squares + np.linalg.slogdet(2 * np.pi * cov)[1]))


def mixture_fusion(
    plant: Plant,
    y: Array,
    u: Array,
    x: Array,
    P: Array,
    *,
    epsilon: float | None = 0.5,
    literal: bool = False,
    start: int = 0,
    feedback: bool = False,
    **rules: Any,
) -> Textbook:
    """Over y (T, m) from the belief x, P about x[0|-1] on."""
    N, sensors = plant.n_sensors, plant.channel_sensor
    own_prior = None if feedback else [steady_prior(plant, sensors == i) for i in range(N)]
    own = np.tile(x, (N, 1))
    rows = []
    numbers: list[tuple[float, ...]] = []
    for k, (yk, uk) in enumerate(zip(y, u, strict=True)):
        here, reading = ~np.isnan(yk), yk - plant.D @ uk
        X, cov = own.copy(), np.zeros((N, plant.n, plant.n))
        for i in range(N):
            before, prior = (x, P) if own_prior is None else (own[i], own_prior[i])
            X[i], cov[i] = correct(plant, before, prior, reading, here & (sensors == i))
        sent = np.array([here[sensors == i].any() for i in range(N)])
        gamma, hat, number = np.ones(N), np.ones(N), (np.nan, 0.0, 0.0, 0.0, 0.0)
        if k >= start and sent.sum() >= 2:
            found = fit(X[sent], cov[sent], x, **rules)
            bar = float(1 - found.gamma.mean())
            swap = epsilon is not None and bar > epsilon
            gamma[sent] = found.gamma
            hat[sent] = 1 - found.gamma if swap else found.gamma
            number = (found.likelihoods[-1], len(found.likelihoods), bar, swap, found.gap)
        x, P = fuse(plant, x, P, reading, here, gamma if literal else hat, hat)
        trust = np.where(sent, hat, np.nan)
        attack = np.where((trust < 0.5)[sensors], reading - plant.C @ x, 0.0)
        rows.append((x, P, trust, np.where(here, attack, np.nan)))
        numbers.append(number)
        x, P = plant.A @ x + plant.B @ uk, plant.A @ P @ plant.A.T + plant.Q
        own = X @ plant.A.T + plant.B @ uk
    names = ("log_likelihood", "iterations", "mean_attacked", "swapped", "gap")
    diagnostics = dict(zip(names, np.array(numbers, dtype=float).T, strict=True))
    return Textbook(*(np.array(column) for column in zip(*rows, strict=True)), diagnostics)


def correct(plant: Plant, x: Array, P: Array, reading: Array, used: NDArray[np.bool_]) -> tuple[Array, Array]:
    """One Kalman correction by the channels `used`."""
    C, R = plant.C[used], plant.R[np.ix_(used, used)]
    K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    F = np.eye(len(x)) - K @ C
    return x + K @ (reading[used] - C @ x), F @ P @ F.T + K @ R @ K.T


def fuse(
    plant: Plant, x: Array, P: Array, reading: Array, here: NDArray[np.bool_], gamma: Array, hat: Array
) -> tuple[Array, Array]:
    """(22c) with the beliefs `hat` and (22d) with `gamma`."""
    information, pull = np.linalg.inv(P), np.zeros(len(x))
    for i in range(plant.n_sensors):
        used = here & (plant.channel_sensor == i)
        C, weight = plant.C[used], np.linalg.inv(plant.R[np.ix_(used, used)])
        information = information + gamma[i] * C.T @ weight @ C
        pull = pull + hat[i] * C.T @ weight @ (reading[used] - C @ x)
    P = np.linalg.inv(information)
    return x + P @ pull, (P + P.T) / 2


def steady_prior(plant: Plant, own: NDArray[np.bool_]) -> Array:
    C, R = plant.C[own], plant.R[np.ix_(own, own)]
    return np.asarray(sl.solve_discrete_are(plant.A.T, C.T, plant.Q, R))
