"""Random plants to identify, and records of them: what is true is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate.identification._scan import scan
from securestate.identification.forms import Independent, Innovations, innovations_of, radius

Array = NDArray[np.float64]

#: Samples before a record begins.
SETTLE = 200


@dataclass(frozen=True)
class Truth:
    """A system in innovations form, and with independent noises if it has them."""

    form: Innovations
    independent: Independent | None


def independent_noises(rng: np.random.Generator) -> Truth:
    """N = 2..10 states, m = 1..10 sensors, 0..3 inputs; noise 1 to 300 % of what the state does to a
    sensor.
    """
    n, m, q = sizes(rng)
    A, B, C = dynamics(rng, n), rng.standard_normal((n, q)), rng.standard_normal((m, n))
    G = rng.standard_normal((n, max(1, int(rng.integers(n // 2 + 1, n + 1)))))
    Q = G @ G.T / n + 1e-3 * np.eye(n)
    X = linalg.solve_discrete_lyapunov(A, Q)
    r = np.einsum("ij,jk,ik->i", C, X, C) * 10 ** rng.uniform(-2.0, 0.5, m)
    model = Independent(A, B, C, np.zeros((m, q)), Q, r)
    return Truth(innovations_of(model), model)


def general(rng: np.random.Generator) -> Truth:
    """A system whose noises are correlated between sensors and with what drives the state."""
    n, m, q = sizes(rng)
    A, B, C = dynamics(rng, n), rng.standard_normal((n, q)), rng.standard_normal((m, n))
    while True:
        K, G = rng.standard_normal((n, m)) / np.sqrt(m), rng.standard_normal((m, m))
        for share in np.linspace(1.0, 0.05, 39):
            if radius(A - share * K @ C) < 0.95:
                return Truth(
                    Innovations(A, B, C, np.zeros((m, q)), share * K, G @ G.T / m + 0.1 * np.eye(m)), None
                )


def sizes(rng: np.random.Generator) -> tuple[int, int, int]:
    """States, sensors and inputs."""
    return int(rng.integers(2, 11)), int(rng.integers(1, 11)), int(rng.integers(0, 4))


def dynamics(rng: np.random.Generator, n: int) -> Array:
    """A with eigenvalues of size .3 to .98, most of them complex, in mixed coordinates."""
    blocks: list[Array] = []
    left = n
    while left:
        size = rng.uniform(0.3, 0.98)
        if left > 1 and rng.random() < 0.6:
            turn = rng.uniform(0.05, 2.5)
            blocks.append(size * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))
            left -= 2
        else:
            blocks.append(np.array([[size if rng.random() < 0.85 else -size]]))
            left -= 1
    T = np.linalg.qr(rng.standard_normal((n, n)))[0] * rng.uniform(0.5, 2, n)
    return np.asarray(T @ linalg.block_diag(*blocks) @ np.linalg.inv(T))


def record(form: Innovations, N: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Y (N, m) and u (N, q): inputs are steps held for 1 to 5 samples."""
    q, total = form.B.shape[1], N + SETTLE
    u = np.zeros((total, q))
    for j in range(q):
        hold = int(rng.integers(1, 6))
        u[:, j] = np.repeat(rng.standard_normal(total // hold + 1), hold)[:total]
    e = rng.standard_normal((total, len(form.C))) @ np.linalg.cholesky(form.S).T
    x = scan(form.A, u @ form.B.T + e @ form.K.T)
    return (x @ form.C.T + u @ form.D.T + e)[SETTLE:], u[SETTLE:]
