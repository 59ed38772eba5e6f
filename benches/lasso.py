"""The LASSO of the paper alone, as sequences of attacked samples with warm start, against general solvers.

min ½ gᵀ H g − ν₀ᵀ g + Σ γ |g_j|, with H the matrix N of a plant scaled to a unit diagonal and ν₀ = −N ζ of
successive samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse
from scipy.stats import norm

from benches.sparse import LEAD, SIZES, TIGHT, Setting
from benches.timing import Comparison, Contender, fastest
from securestate import _kernels

Float = NDArray[np.float64]
TOLERANCE = 1e-6
#: Accuracy asked of OSQP, and its limit of iterations.
ACCURACY, LIMIT = 1e-8, 20_000
#: Samples in a turn of OSQP for every one of CVXPY.
SHARE = 4


@dataclass(frozen=True)
class Sequence:
    """H (d, d), γ, and ν₀ (T, d) with the energy q = ζᵀ N ζ of each sample; x = F ζ + F_g g."""

    H: Float
    gamma: float
    linear: Float
    energy: Float
    kalman: Float
    F_g: Float

    @property
    def d(self) -> int:
        return len(self.H)

    def fuse(self, g: Float) -> Float:
        """x, which is unique even where g is not."""
        return self.kalman[: len(g)] + g @ self.F_g.T


def _sequence(n: int, m: int, liars: int) -> Sequence:
    setting = Setting(n, m)
    parts = setting.estimator.decomposition
    zeta = setting.locals_(setting.measurements(liars))[LEAD:]
    root = np.sqrt(np.diag(parts.N))
    product, F = -zeta @ parts.N, np.hstack(list(parts.F))
    return Sequence(
        H=parts.N / np.outer(root, root),
        gamma=float(norm.isf((1 - 0.95 ** (1 / (n * m))) / 2)),
        linear=product / root,
        energy=-np.einsum("ki,ki->k", zeta, product),
        kalman=zeta @ F.T,
        F_g=F / root,
    )


def lassos(quick: bool) -> Iterator[Comparison]:
    """Attacked samples one after the other, each starting from the solution of the one before."""
    for n, m, liars, count in SIZES[:1] if quick else SIZES:
        sequence = _sequence(n, m, liars)
        ours, size = _ours(sequence), f"d={n * m}"
        theirs, precise = _cvxpy(sequence, count, {}), _cvxpy(sequence, count, TIGHT)
        yield Comparison("LASSO", size, ours, theirs, TOLERANCE, None, precise)
        count = min(SHARE * count, len(sequence.linear))
        rivals = [_osqp_split(sequence, count), _osqp_dual(sequence, count)]
        yield Comparison("LASSO", size, ours, fastest(rivals), np.inf)


def _ours(sequence: Sequence) -> Contender:
    d, samples = sequence.d, list(zip(sequence.linear, sequence.energy.tolist(), strict=True))

    def prepare() -> _kernels.PenaltySolver:
        return _kernels.PenaltySolver(sequence.H, list(range(d + 1)), np.full(d, sequence.gamma))

    def work(solver: _kernels.PenaltySolver) -> Float:
        return sequence.fuse(np.array([solver.solve(nu, energy)[0] for nu, energy in samples]))

    return Contender("securestate", work, len(samples), prepare)


def _cvxpy(sequence: Sequence, count: int, options: dict[str, float]) -> Contender:
    g, nu = cp.Variable(sequence.d), cp.Parameter(sequence.d)
    cost = 0.5 * cp.quad_form(g, cp.psd_wrap(sequence.H)) - nu @ g + sequence.gamma * cp.norm1(g)
    problem = cp.Problem(cp.Minimize(cost))

    def work(_: None) -> Float:
        solutions = []
        for row in sequence.linear[:count]:
            nu.value = row
            problem.solve(cp.CLARABEL, warm_start=True, presolve_enable=False, **options)
            solutions.append(g.value)
        return sequence.fuse(np.array(solutions))

    return Contender("CVXPY + Clarabel (quadratic form, solver reused)", work, count)


def _osqp(P: sparse.csc_matrix, A: sparse.csc_matrix, lower: Float, upper: Float) -> osqp.OSQP:
    solver = osqp.OSQP()
    solver.setup(
        P, np.zeros(P.shape[0]), A, lower, upper,
        verbose=False, eps_abs=ACCURACY, eps_rel=ACCURACY, max_iter=LIMIT, warm_starting=True,
    )  # fmt: skip
    return solver


def _osqp_split(sequence: Sequence, count: int) -> Contender:
    """The textbook form: −t ≤ g ≤ t, γ 1ᵀ t in the cost."""
    d = sequence.d
    eye = sparse.eye_array(d, format="csc")
    P = sparse.csc_matrix(sparse.block_diag([np.triu(sequence.H), sparse.csc_matrix((d, d))]))
    A = sparse.csc_matrix(sparse.vstack([sparse.hstack([eye, -eye]), sparse.hstack([eye, eye])]))
    infinite, zero = np.full(d, np.inf), np.zeros(d)
    bounds = np.concatenate([-infinite, zero]), np.concatenate([zero, infinite])
    penalty = np.full(d, sequence.gamma)
    rows = [np.concatenate([-row, penalty]) for row in sequence.linear[:count]]

    def prepare() -> osqp.OSQP:
        return _osqp(P, A, *bounds)

    def work(solver: osqp.OSQP) -> Float:
        solutions = []
        for q in rows:
            solver.update(q=q)
            solutions.append(solver.solve(raise_error=False).x[:d].copy())
        return sequence.fuse(np.array(solutions))

    return Contender("OSQP, tolerance 1e-8 (|g| ≤ t, warm start)", work, count, prepare)


def _osqp_dual(sequence: Sequence, count: int) -> Contender:
    """The dual: min ½ gᵀ H g with |ν₀ − H g| ≤ γ; the multipliers of the box are the solution."""
    gamma = sequence.gamma
    P, A = sparse.csc_matrix(np.triu(sequence.H)), sparse.csc_matrix(sequence.H)
    first = sequence.linear[0]

    def prepare() -> osqp.OSQP:
        return _osqp(P, A, first - gamma, first + gamma)

    def work(solver: osqp.OSQP) -> Float:
        solutions = []
        for row in sequence.linear[:count]:
            solver.update(l=row - gamma, u=row + gamma)
            solutions.append(-solver.solve(raise_error=False).y)
        return sequence.fuse(np.array(solutions))

    return Contender("OSQP, tolerance 1e-8 (dual box, warm start)", work, count, prepare)


CASES: dict[str, Callable[[bool], Iterator[Comparison]]] = {"lasso": lassos}
