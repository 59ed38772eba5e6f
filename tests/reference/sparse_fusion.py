"""Sparse fusion as in the paper, dense and slow: the textbook the package is compared with."""

import warnings

import cvxpy as cp
import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

Array = NDArray[np.float64]


def local_maps_by_inverses(A: Array, C: Array, eigenvalues: Array) -> Array:
    """G_i of (18) for a diagonalisable M: row l is C_i A (A − λ_l I)⁻¹. Shape (m, n, n)."""
    n = len(A)
    inverses = [np.linalg.inv(A - value * np.eye(n)) for value in eigenvalues]
    return np.array([[row @ A @ inverse for inverse in inverses] for row in C])


def fusion_maps_by_eigenvectors(M: Array, K: Array, eigenvalues: Array) -> Array:
    """F_i = V diag(V⁻¹ K_i) of (13)-(14) for a diagonalisable M. Shape (m, n, n)."""
    values, V = np.linalg.eig(M)
    V = V[:, [int(np.argmin(np.abs(values - value))) for value in eigenvalues]]
    return np.array([V @ np.diag(np.linalg.solve(V, column)) for column in K.T])


def covariance_by_one_large_equation(
    A: Array, C: Array, Q: Array, R: Array, T: Array, b: Array, V: Array, n_u: int
) -> Array:
    """W (29) from one dense Stein equation in (x_s, ε_1 … ε_m); x = V (x_u, x_s)."""
    n, m = len(A), len(C)
    n_s, back = n - n_u, np.linalg.inv(V)
    V_u, V_s = V[:, :n_u], V[:, n_u:]
    assert np.allclose((back @ A @ V)[:n_u, n_u:], 0) and np.allclose((back @ A @ V)[n_u:, :n_u], 0)
    A_u, A_s = (back @ A @ V)[:n_u, :n_u], (back @ A @ V)[n_u:, n_u:]
    size = n_s + m * n
    step, noise = np.zeros((size, size)), np.zeros((size, n + m))
    step[:n_s, :n_s], noise[:n_s, :n] = A_s, back[n_u:]
    for i, row in enumerate(C):
        s = slice(n_s + i * n, n_s + (i + 1) * n)
        G = sl.solve_sylvester(-T, A_u, np.outer(b, row @ V_u @ A_u)) if n_u else np.zeros((n, 0))
        step[s, s], step[s, :n_s] = T, -np.outer(b, row @ V_s @ A_s)
        noise[s, :n] = G @ back[:n_u] - np.outer(b, row)
        noise[s, n + i] = -b
    cov = noise @ sl.block_diag(Q, R) @ noise.T
    return sl.solve_discrete_lyapunov(step, cov)[n_s:, n_s:]


def information_left(W: Array, G: Array) -> Array:
    """N = W⁻¹ − W⁻¹ G (Gᵀ W⁻¹ G)⁻¹ Gᵀ W⁻¹."""
    inverse = np.linalg.inv(W)
    if not G.shape[1]:
        return inverse
    return inverse - inverse @ G @ np.linalg.solve(G.T @ inverse @ G, G.T @ inverse)


def secure_fusion(
    zeta: Array, W: Array, G: Array, groups: list[Array], gammas: list[float], metrics: list[Array]
) -> Array:
    """f of problem (31) by CVXPY, x and φ minimised out by projection.

    In coordinates g_j = metric_j f_j, so that the penalty is Σ γ_j ‖g_j‖₂: there Clarabel reaches 1e-6,
    in the form as printed it does not.
    """
    L = np.linalg.cholesky(W)
    root = sl.solve_triangular(L, np.eye(len(W)), lower=True)
    if G.shape[1]:
        basis = np.linalg.qr(root @ G)[0]
        root = root - basis @ (basis.T @ root)
    order = np.concatenate(groups)
    back = sl.block_diag(*[np.linalg.inv(M) for M in metrics])  # f[order] = back g
    g = cp.Variable(len(order))
    starts = np.cumsum([0] + [len(j) for j in groups])
    bounds = list(zip(gammas, starts[:-1], starts[1:], strict=True))
    offset, mix = root @ zeta, root[:, order] @ back
    penalty = sum(gamma * cp.norm(g[a:b], 2) for gamma, a, b in bounds)
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(offset + mix @ g) + penalty))
    best, lowest = np.zeros(len(order)), np.inf
    for tolerance in (
        1e-9,
        1e-10,
        1e-11,
        1e-12,
    ):  # Clarabel breaks down earlier on some problems than on others
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(
                solver=cp.CLARABEL, tol_gap_abs=tolerance, tol_gap_rel=tolerance, tol_feas=tolerance
            )
        value = np.asarray(g.value)
        cost = 0.5 * np.sum((offset + mix @ value) ** 2)
        cost += sum(gamma * np.linalg.norm(value[a:b]) for gamma, a, b in bounds)
        if cost < lowest:
            best, lowest = value, cost
    f = np.zeros(len(zeta))
    f[order] = back @ best
    return f
