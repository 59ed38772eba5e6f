"""Constant matrices of the decomposition of a Kalman filter into one local filter per channel.

Atoms: mathematics on arrays in the paper's letters. `sparse_fusion.py` gives them names and settings.

Every local filter runs  ζ_i(k+1) = T ζ_i(k) + b y_i(k+1)  (12). Its error  ε_i = G_i x_u − ζ_i  obeys (19)
and has the covariance W (29). Only the modes x_u that need a flat prior get columns of G; the others, x_s,
keep their stationary prior and are noise to the local filters. The paper is the special case x_u = x.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from securestate.errors import DesignError

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Split:
    """A = V diag(A_u, A_s) V⁻¹; the first n_u coordinates get a flat prior.

    Attributes:
        V: (n, n), its first n_u columns span the flat modes.
        V_inv: its inverse.
        A_u: (n_u, n_u).
        A_s: (n_s, n_s), stable.
    """

    V: Float
    V_inv: Float
    A_u: Float
    A_s: Float

    @property
    def flat(self) -> int:
        """n_u."""
        return len(self.A_u)


def split_modes(A: Float, M: Float, cut: float) -> Split:
    """Block-diagonalise A into modes with |μ| ≥ cut and the rest, by an ordered real Schur form.

    A stable mode that the filter cannot move (no noise reaches it or no sensor sees it, so M keeps it) has
    the same eigenvalue in A and M. It needs no flat prior and stays with the rest: (20) is always solvable.
    """
    mu, poles = np.linalg.eigvals(A), np.linalg.eigvals(M)
    kept = np.array([z for z in mu if abs(z) < 1 and np.min(np.abs(poles - z)) < 1e-9])

    def is_flat(re: float, im: float = 0.0) -> bool:
        return bool(np.hypot(re, im) >= cut and np.min(np.abs(kept - (re + 1j * im)), initial=np.inf) > 1e-8)

    return _split(A, is_flat)


def no_split(A: Float) -> Split:
    """All modes get a flat prior: the paper's problem (30)."""
    n = len(A)
    return Split(np.eye(n), np.eye(n), A, np.zeros((0, 0)))


def _split(A: Float, is_flat: Callable[..., bool]) -> Split:
    n = len(A)
    S, Z, k = sl.schur(A, output="real", sort=is_flat)
    X: Float = np.zeros((k, n - k))
    if 0 < k < n:
        X = np.asarray(sl.solve_sylvester(S[:k, :k], -S[k:, k:], -S[:k, k:]), dtype=np.float64)
    V = Z @ np.block([[np.eye(k), X], [np.zeros((n - k, k)), np.eye(n - k)]])
    V_inv = np.block([[np.eye(k), -X], [np.zeros((n - k, k)), np.eye(n - k)]]) @ Z.T
    return Split(V, V_inv, S[:k, :k], S[k:, k:])


def observation_maps(split: Split, T: Float, b: Float) -> Float:
    """E_j with E_j A_u − b e_jᵀ V_u A_u = T E_j (20) for unit rows e_j; G_i = Σ_j C_ij E_j. (n, n, n_u)."""
    V_u, A_u = split.V[:, : split.flat], split.A_u
    if not split.flat:
        return np.zeros((len(T), len(T), 0))
    return np.stack([sl.solve_sylvester(-T, A_u, np.outer(b, row @ A_u)) for row in V_u])


def fusion_maps(M: Float, K: Float, T: Float, b: Float, gramian: Float | None) -> Float:
    """F_i with F_i T = M F_i and F_i b = K_i (13), shape (m, n, n).

    Solved as X = M X Tᵀ + K_i bᵀ, F_i = X Γ⁻¹ with the Gramian Γ = T Γ Tᵀ + b bᵀ (None means Γ = I): this
    holds in every basis, where (13)-(14) need the Jordan form.
    """
    X = stein(M, K.T[:, :, np.newaxis] * b, T.T)
    if gramian is None:
        return X
    factor = sl.cho_factor(gramian)
    return np.stack([sl.cho_solve(factor, Xi.T).T for Xi in X])


def stein(left: Float, X: Float, right: Float) -> Float:
    """Z = left Z right + X by doubling; `left` and `right` stable, X may be a stack (…, p, q)."""
    Z, a, c = X, left, right
    for _ in range(60):
        step = a @ Z @ c
        Z = Z + step
        if np.abs(step).max(initial=0.0) <= 1e-18 * np.abs(Z).max(initial=0.0):
            return Z
        a, c = a @ a, c @ c
    raise DesignError(
        "the local filters do not forget: A − K C A or a noise mode of A lies on the unit circle to rounding",
        "give every mode of A some process noise",
    )


def local_error_covariance(split: Split, E: Float, Q: Float, T: Float, b: Float) -> Float:
    """Stationary covariance (29) of the errors of n unit sensors without measurement noise, (n, n, n, n).

    Entry [i, :, j, :] is Cov(ε_i, ε_j). With process noise w and, per unit sensor j with row e_j,
        x_s⁺ = A_s x_s + w_s,
        ε_j⁺ = T ε_j + (E_j V_u⁻ − b e_jᵀ) w − b e_jᵀ V_s A_s x_s.
    The three blocks are Stein equations of size n, never one of size n².
    """
    n, k = len(T), split.flat
    W_s = split.V_inv[k:]
    V_s, A_s = split.V[:, k:], split.A_s
    H = E @ split.V_inv[:k] - b[:, np.newaxis] * np.eye(n)[:, np.newaxis, :]  # (n, n, n): per unit sensor
    g = V_s @ A_s  # (n, n_s): row j drives unit sensor j through −b
    P_s = stein(A_s, W_s @ Q @ W_s.T, A_s.T)
    HQ = H @ Q
    # Cov(x_s, ε_j), shape (n, n_s, n)
    X = stein(A_s, W_s @ HQ.transpose(0, 2, 1) - (A_s @ P_s @ g.T).T[:, :, np.newaxis] * b, T.T)
    # terms of Cov(ε_i⁺, ε_j⁺) without T … Tᵀ
    driven = np.einsum("iab,jcb->iajc", HQ, H)
    cross = np.einsum("a,is,jsc->iajc", b, -g, X @ T.T)
    driven += cross + cross.transpose(2, 3, 0, 1)
    driven += np.einsum("a,ij,c->iajc", b, g @ P_s @ g.T, b)
    Z = stein(T, driven.transpose(0, 2, 1, 3), T.T).transpose(0, 2, 1, 3)
    return (Z + Z.transpose(2, 3, 0, 1)) / 2


@dataclass(frozen=True)
class Weights:
    """W and N in factored form. `U` mixes channels: N = R⁻¹ ⊗ Γ⁻¹ − (Z ⊗ L) K (Z ⊗ L)ᵀ with Γ⁻¹ = L Lᵀ.

    Attributes:
        precision: R⁻¹, (m, m).
        Z: R^{-T/2} U, (m, r), U an orthonormal basis of the range of R^{-1/2} C.
        K: (r n, r n), symmetric, I − the reduced N.
        gram_root: L, (n, n).
        spread: largest variance of a local error in units of its measurement noise.
    """

    precision: Float
    Z: Float
    K: Float
    gram_root: Float
    spread: float

    def dense(self) -> Float:
        """N = W⁻¹ − W⁻¹ G (Gᵀ W⁻¹ G)⁻¹ Gᵀ W⁻¹, (m n, m n)."""
        mix = np.kron(self.Z, self.gram_root)
        N = np.kron(self.precision, self.gram_root @ self.gram_root.T) - mix @ self.K @ mix.T
        return (N + N.T) / 2


def weights(C: Float, R: Float, E: Float, unit_cov: Float, gramian: Float | None) -> Weights:
    """Reduce W = R ⊗ Γ + (C ⊗ I) Ŵ (Cᵀ ⊗ I) to the range of C and project out G.

    In the coordinates R^{-1/2} ⊗ Γ^{-1/2} the complement of range(C) is untouched by both, so that the
    factorisation has the size r n with r = rank C ≤ min(n, m) instead of m n.
    """
    n = C.shape[1]
    R_root = np.linalg.cholesky(R)
    U, s, Vt = np.linalg.svd(sl.solve_triangular(R_root, C, lower=True), full_matrices=False)
    r = int(np.sum(s > 1e-13 * s[0]))
    U, reduced_C = U[:, :r], s[:r, np.newaxis] * Vt[:r]
    root = np.eye(n)
    if gramian is not None:
        root = sl.solve_triangular(np.linalg.cholesky(gramian), root, lower=True).T
    cov = np.einsum("ij,jakb,lk->ialb", reduced_C, unit_cov, reduced_C, optimize=True)
    cov = np.einsum("ap,iajb,bq->ipjq", root, cov, root, optimize=True).reshape(r * n, r * n)
    W = np.eye(r * n) + (cov + cov.T) / 2
    G = np.einsum("ij,jak,ap->ipk", reduced_C, E, root, optimize=True).reshape(r * n, -1)
    L = np.linalg.cholesky(W)
    Y = sl.solve_triangular(L, np.eye(r * n), lower=True)
    if G.shape[1]:
        basis = np.linalg.qr(sl.solve_triangular(L, G, lower=True))[0]
        Y -= basis @ (basis.T @ Y)
    Z = sl.solve_triangular(R_root, U, lower=True, trans="T")
    precision = sl.cho_solve((R_root, True), np.eye(len(R)))
    return Weights(precision, Z, np.eye(r * n) - Y.T @ Y, root, float(np.max(np.diag(W), initial=1.0)))


def dense_covariance(C: Float, R: Float, unit_cov: Float, gramian: Float | None) -> Float:
    """W = R ⊗ Γ + (C ⊗ I) Ŵ (Cᵀ ⊗ I) (29), (m n, m n)."""
    m, n = C.shape
    noise = np.kron(R, np.eye(n) if gramian is None else gramian)
    process = np.einsum("ij,jakb,lk->ialb", C, unit_cov, C, optimize=True).reshape(m * n, m * n)
    return np.asarray(noise + (process + process.T) / 2, dtype=np.float64)
