"""Joint fusion in the paper's own variables: Lemma 1, Theorem 1, Theorem 2 and (12). Slow.

printed=False repairs the recursions: Xi^1 = E_k + E_{k-1} + V + g E_{k-1} + E_{k-1} g' with g = Gamma C^a F,
and R_ij in Theorem 2. Sample 0 is corrected with the prior as it is; a missing channel is a row of zeros.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from securestate import Plant

Array = NDArray[np.float64]
#: Channels that may lie and channels that do not, of one local estimator.
Stack = tuple[Sequence[int], Sequence[int]]


@dataclass
class Adaptive:
    """Eta from the innovations of a local, given those of its protected channels."""

    window: int
    gate: float
    past: dict[int, list[float]] = field(default_factory=dict)

    def __call__(self, channel: int, nu: float, S: float) -> float:
        past = self.past[channel] = [*self.past.get(channel, []), nu**2 - S][-self.window :]
        return max(0.0, float(np.mean(past)), past[-1] if nu**2 > self.gate * S else 0.0)


@dataclass
class Textbook:
    """Per sample; lists per local. x (T, n) fused, X (T, n + p), phi (T, p), and the moments."""

    x: Array
    innovation: Array
    X: list[Array]
    phi: list[Array]
    K: list[Array]
    Gamma: list[Array]
    P_X: list[Array]
    U: list[Array]
    V: list[Array]
    Sigma: Array
    G: Array
    P0: Array
    eta: Array


def joint_fusion(
    plant: Plant,
    stacks: Sequence[Stack],
    y: Array,
    u: Array,
    x: Array,
    P: Array,
    eta: Array | Adaptive,
    *,
    printed: bool = False,
    heard: NDArray[np.bool_] | None = None,
) -> Textbook:
    """Over y (T, m), NaN where missing, with u (T, q), from the belief x (n,), P; eta (T, sum of p).

    `heard` (T, r, m) says which channels a local hears, if it does not hear all that arrives.
    """
    locals_ = [Local(plant, stack, x, P, printed) for stack in stacks]
    r = len(locals_)
    pairs = {(i, j): Pair(plant, locals_[i], locals_[j], P) for i in range(r) for j in range(i + 1, r)}
    rows: list[dict[str, Any]] = []
    fused = x
    for k, (yk, uk) in enumerate(zip(y, u, strict=True)):
        ends = np.cumsum([local.p for local in locals_])
        for i, (local, end) in enumerate(zip(locals_, ends, strict=True)):
            local.predict(k, u[k - 1])
            own = local.choose(eta, k, yk, uk) if isinstance(eta, Adaptive) else eta[k, end - local.p : end]
            local.correct(k, yk if heard is None else np.where(heard[k, i], yk, np.nan), uk, own)
        Sigma = np.zeros((plant.n * r, plant.n * r))
        for i, local in enumerate(locals_):
            put(Sigma, i, i, local.PX[: plant.n, : plant.n])
        for (i, j), pair in pairs.items():
            pair.correct()
            put(Sigma, i, j, pair.PX[: plant.n, : plant.n])
        G, P0 = optimal_weights(Sigma, plant.n)
        expected = fused if k == 0 else at(plant.A, k - 1) @ fused + plant.B @ u[k - 1]
        fused = G @ np.concatenate([local.X[: plant.n] for local in locals_])
        shared = {"x": fused, "Sigma": Sigma, "G": G, "P0": P0}
        shared["innovation"] = yk - at(plant.C, k) @ expected - plant.D @ uk
        shared["eta"] = np.concatenate([local.eta for local in locals_])
        rows.append(shared | {name: [getattr(one, kept) for one in locals_] for name, kept in KEPT.items()})
    return Textbook(
        **{name: np.array([row[name] for row in rows]) for name in rows[0] if name not in KEPT},
        **{name: [np.array([row[name][i] for row in rows]) for i in range(r)] for name in KEPT},
    )


KEPT = {"X": "X", "phi": "phi", "K": "K", "Gamma": "Gamma", "P_X": "PX", "U": "U", "V": "V"}


def optimal_weights(Sigma: Array, n: int) -> tuple[Array, Array]:
    """(12) and the covariance of what it fuses; if Sigma has no inverse, min tr G Sigma G', G H = I."""
    H = np.tile(np.eye(n), (len(Sigma) // n, 1))
    if np.linalg.cond(Sigma) > 1e9:
        whole = np.block([[Sigma, H], [H.T, np.zeros((n, n))]])
        right = np.vstack([np.zeros_like(H), np.eye(n)])
        G = np.linalg.lstsq(whole, right, rcond=1e-10)[0][: len(Sigma)].T
        return G, G @ Sigma @ G.T
    information = np.linalg.solve(Sigma, H)
    P0 = np.linalg.inv(H.T @ information)
    return P0 @ information.T, P0


class Local:
    """One local estimator: Lemma 1 and Theorem 1."""

    def __init__(self, plant: Plant, stack: Stack, x: Array, P: Array, printed: bool) -> None:
        weak, protected = stack
        self.plant, self.channels, self.p, self.printed = plant, [*weak, *protected], len(weak), printed
        n, p = plant.n, self.p
        self.F = np.vstack([np.zeros((n, p)), np.eye(p)])
        self.X, self.phi = np.concatenate([x, np.zeros(p)]), np.zeros(p)
        self.start, self.eta = P, np.zeros(p)
        self.U, self.V, self.g = np.zeros((n + p, p)), np.zeros((p, p)), np.zeros((p, p))
        self.KaF, self.Pphi, self.PX = self.F, np.zeros((p, p)), block_diag(P, np.zeros((p, p)))

    def predict(self, k: int, u: Array) -> None:
        n, p = self.plant.n, self.p
        A, Q = (np.eye(n), np.zeros((n, n))) if k == 0 else (at(self.plant.A, k - 1), self.plant.Q)
        self.A, self.Q = block_diag(A, np.eye(p)), block_diag(Q, np.zeros((p, p)))
        self.X = self.A @ self.X + self.F @ self.phi
        if k:
            self.X[:n] += self.plant.B @ u

    def choose(self, adaptive: Adaptive, k: int, y: Array, u: Array) -> Array:
        """Eta of every channel that may lie; 0 where it did not arrive."""
        n, p = self.plant.n, self.p
        C, sent = at(self.plant.C, k)[self.channels], ~np.isnan(y[self.channels])
        P = (self.A @ self.PX @ self.A.T + self.Q)[:n, :n]
        nu = y[self.channels] - C @ self.X[:n] - self.plant.D[self.channels] @ u
        S = C @ P @ C.T + self.plant.R[np.ix_(self.channels, self.channels)]
        told, eta = np.flatnonzero(sent & (np.arange(len(sent)) >= p)), np.zeros(p)
        for q in np.flatnonzero(sent[:p]):
            gain = S[q, told] @ np.linalg.inv(S[np.ix_(told, told)])
            left = S[q, q] - gain @ S[told, q]
            eta[q] = adaptive(self.channels[q], float(nu[q] - gain @ nu[told]), float(left))
        return eta

    def correct(self, k: int, y: Array, u: Array, eta: Array) -> None:
        A, F, n, p, E, before = self.A, self.F, self.plant.n, self.p, np.diag(eta), np.diag(self.eta)
        if k == 0 or self.printed:
            before = E
        if k == 0:
            self.PX[n:, n:], self.Pphi = E, 2 * E
        sent = ~np.isnan(y[self.channels])
        C = np.hstack([at(self.plant.C, k)[self.channels], np.eye(len(sent), p)]) * sent[:, None]
        R = self.plant.R[np.ix_(self.channels, self.channels)] * np.outer(sent, sent)
        g, I = self.g, np.eye(p)
        if self.printed:
            D = 6 * E - self.Pphi - E @ (I - g).T - (I - g) @ E  # (19)
        else:
            D = E + before + self.V + g @ before + before @ g.T
        X2 = self.U + self.KaF @ before
        Xi = A @ self.PX @ A.T + self.Q + F @ D @ F.T - A @ X2 @ F.T - F @ (A @ X2).T
        S = C @ Xi @ C.T + R
        inverse = np.linalg.inv(S + np.diag(1.0 - sent))
        K = Xi @ C.T @ inverse  # (37)
        Gamma = (D @ F.T - (A @ X2).T) @ C.T @ inverse  # (36)
        Ka, GC = np.eye(n + p) - K @ C, Gamma @ C
        g_now, GSG = GC @ F, Gamma @ S @ Gamma.T
        self.Pphi = (I - g_now) @ D - D @ g_now.T + GC @ A @ X2 + (GC @ A @ X2).T + GSG  # (15)
        self.PX = Ka @ Xi @ Ka.T + K @ R @ K.T  # (16)
        past = A @ self.U - F @ self.V - F @ before @ g.T
        self.U = Ka @ past + Ka @ Xi @ GC.T - K @ R @ Gamma.T  # (17)
        self.V = self.V + GC @ past + (GC @ past).T + GSG  # (18)
        self.K, self.Gamma, self.C, self.Ka, self.GC, self.g = K, Gamma, C, Ka, GC, g_now
        self.KaF, self.eta = Ka @ F, eta
        surprise = y[self.channels] - self.plant.D[self.channels] @ u
        surprise = np.where(sent, surprise - C @ self.X, 0.0)
        self.X, self.phi = self.X + K @ surprise, self.phi + Gamma @ surprise  # (6)


class Pair:
    """Two local estimators: Theorem 2."""

    def __init__(self, plant: Plant, i: Local, j: Local, P: Array) -> None:
        n = plant.n
        self.i, self.j = i, j
        self.R = plant.R[np.ix_(i.channels, j.channels)] * (not i.printed)
        self.PX = np.zeros((n + i.p, n + j.p))
        self.PX[:n, :n] = P
        self.U, self.Uji = np.zeros((n + i.p, j.p)), np.zeros((n + j.p, i.p))
        self.V, self.Pphi, self.Y = np.zeros((3, i.p, j.p))
        self.Yji = np.zeros((j.p, i.p))

    def correct(self) -> None:
        i, j, R, V = self.i, self.j, self.R, self.V
        X1 = self.Pphi + self.Y + self.Yji.T if i.printed else -V  # (50)
        Q = np.zeros_like(self.PX)
        n = i.plant.n
        Q[:n, :n] = i.Q[:n, :n]
        Xi = i.A @ self.PX @ j.A.T + Q - i.A @ self.U @ j.F.T - i.F @ (j.A @ self.Uji).T - i.F @ X1 @ j.F.T
        core = i.GC @ Xi @ j.GC.T + i.Gamma @ R @ j.Gamma.T
        both = (j.GC @ j.A @ self.Uji).T + i.GC @ i.A @ self.U
        self.Pphi = i.g @ X1 - X1 @ (np.eye(j.p) - j.g).T + both + core  # (45)
        self.PX = i.Ka @ Xi @ j.Ka.T + i.K @ R @ j.K.T  # (46)
        self.U = i.Ka @ (i.A @ self.U - i.F @ V) + i.Ka @ Xi @ j.GC.T - i.K @ R @ j.Gamma.T  # (47)
        self.Uji = j.Ka @ (j.A @ self.Uji - j.F @ V.T) + j.Ka @ Xi.T @ i.GC.T - j.K @ R.T @ i.Gamma.T
        self.Y = -both - X1 @ j.g.T - (np.eye(i.p) - i.g) @ V - core  # (48)
        self.Yji = -both.T - X1.T @ i.g.T - (np.eye(j.p) - j.g) @ V.T - core.T
        self.V = core + V @ (np.eye(j.p) - j.g).T - i.g @ V + both  # (49)


def put(Sigma: Array, i: int, j: int, block: Array) -> None:
    n = len(block)
    Sigma[n * i : n * (i + 1), n * j : n * (j + 1)] = block
    Sigma[n * j : n * (j + 1), n * i : n * (i + 1)] = block.T


def at(M: Array, k: int) -> Array:
    return M[k] if M.ndim == 3 else M
