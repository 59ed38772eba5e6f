"""Identification as in a textbook: all states and readings of a short record in one joint Gaussian. Slow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from securestate.identification.forms import Independent

Array = NDArray[np.float64]


def plain_scan(F: Array, g: Array) -> Array:
    """x[k+1] = F x[k] + g[k] from x[0] = 0, one sample after the other, (N, n)."""
    x, states = np.zeros(len(F)), []
    for drive in g:
        states.append(x)
        x = F @ x + drive
    return np.array(states)


@dataclass
class Gaussian:
    """All x[0..N-1], then all y[0..N-1], as one vector: its mean and covariance."""

    mean: Array
    cov: Array
    N: int
    n: int
    m: int

    @property
    def readings(self) -> Array:
        """Mean of all y, (N m,)."""
        return self.mean[self.N * self.n :]

    @property
    def readings_cov(self) -> Array:
        return self.cov[self.N * self.n :, self.N * self.n :]


def joint(model: Independent, u: Array, mean: Array, start: Array) -> Gaussian:
    """Before anything is read: x[0] ~ N(mean, start), then the model with these inputs."""
    A, B, C, D, n, m, N = model.A, model.B, model.C, model.D, model.n, len(model.C), len(u)
    means = [mean]
    for k in range(N - 1):
        means.append(A @ means[-1] + B @ u[k])
    variance = [start]
    for _ in range(N - 1):
        variance.append(A @ variance[-1] @ A.T + model.Q)
    P = np.zeros((N, n, N, n))
    for j in range(N):
        for k in range(j, N):
            P[k, :, j, :] = np.linalg.matrix_power(A, k - j) @ variance[j]
            P[j, :, k, :] = P[k, :, j, :].T
    states = P.reshape(N * n, N * n)
    H = np.kron(np.eye(N), C)
    noise = np.diag(np.tile(model.r, N))
    cov = np.block([[states, states @ H.T], [H @ states, H @ states @ H.T + noise]])
    readings = np.concatenate([C @ x + D @ v for x, v in zip(means, u, strict=True)])
    return Gaussian(np.concatenate([*means, readings]), cov, N, n, m)


def conditioned(prior: Gaussian, y: Array) -> tuple[Gaussian, float]:
    """Once y (N, m) is read, NaN where it is missing; and log p(y)."""
    there = np.flatnonzero(np.isfinite(y.ravel())) + prior.N * prior.n
    if not len(there):
        return prior, 0.0
    S = prior.cov[np.ix_(there, there)]
    e = y.ravel()[np.isfinite(y.ravel())] - prior.mean[there]
    gain = np.linalg.solve(S, prior.cov[there]).T
    mean, cov = prior.mean + gain @ e, prior.cov - gain @ prior.cov[there]
    density = -0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(2 * np.pi * S)[1])
    return Gaussian(mean, cov, prior.N, prior.n, prior.m), float(density)


def moments(known: Gaussian, u: Array) -> dict[str, Array]:
    """Expected sums of products, sample by sample: z = (x, u)."""
    N, n, m, q = known.N, known.n, known.m, u.shape[1]
    second = known.cov + np.outer(known.mean, known.mean)

    def x(k: int) -> slice:
        return slice(k * n, (k + 1) * n)

    def y(k: int) -> slice:
        return slice(N * n + k * m, N * n + (k + 1) * m)

    def z_with(k: int, other: slice) -> Array:
        return np.vstack([second[x(k), other], np.outer(u[k], known.mean[other])])

    def z_with_z(k: int) -> Array:
        return np.hstack(
            [z_with(k, x(k)), np.vstack([np.outer(known.mean[x(k)], u[k]), np.outer(u[k], u[k])])]
        )

    zeros = {"zz": np.zeros((n + q, n + q)), "zx": np.zeros((n + q, n)), "xx": np.zeros((n, n))}
    sums = zeros | {"gg": np.zeros((n + q, n + q)), "gy": np.zeros((n + q, m)), "yy": np.zeros(m)}
    for k in range(N):
        sums["gg"] += z_with_z(k)
        sums["gy"] += z_with(k, y(k))
        sums["yy"] += np.diag(second[y(k), y(k)])
    for k in range(N - 1):
        sums["zz"] += z_with_z(k)
        sums["zx"] += z_with(k, x(k + 1))
        sums["xx"] += second[x(k + 1), x(k + 1)]
    return sums


def one_reading(prior: Gaussian, y: Array, channel: int, k: int) -> float:
    """What y[k] of a channel is expected to be, given the other channels at samples 0..k."""
    heard = np.full_like(y, np.nan)
    heard[: k + 1] = y[: k + 1]
    heard[:, channel] = np.nan
    known, _ = conditioned(prior, heard)
    return float(known.readings[k * prior.m + channel])


def innovations_gaussian(
    A: Array, C: Array, K: Array, S: Array, drive: Array, through: Array, start: Array
) -> Gaussian:
    """The same for x[k+1] = A x[k] + g[k] + K e[k], y[k] = C x[k] + d[k] + e[k], e ~ N(0, S).

    Only y is filled in. x[0] ~ N(0, start). Every y is written as a linear map of x[0] and all e.
    """
    N, n, m = len(drive), len(A), len(C)
    maps, mean, x_map, x_mean = [], [], np.hstack([np.eye(n), np.zeros((n, N * m))]), np.zeros(n)
    for k in range(N):
        e_map = np.zeros((m, n + N * m))
        e_map[:, n + k * m : n + (k + 1) * m] = np.eye(m)
        maps.append(C @ x_map + e_map)
        mean.append(C @ x_mean + through[k])
        x_map, x_mean = A @ x_map + K @ e_map, A @ x_mean + drive[k]
    whole = np.vstack(maps)
    sources = np.zeros((n + N * m, n + N * m))
    sources[:n, :n], sources[n:, n:] = start, np.kron(np.eye(N), S)
    cov = np.zeros((N * (n + m), N * (n + m)))
    cov[N * n :, N * n :] = whole @ sources @ whole.T
    return Gaussian(np.concatenate([np.zeros(N * n), *mean]), cov, N, n, m)
