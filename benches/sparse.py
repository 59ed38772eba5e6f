"""SparseFusion against CVXPY with Clarabel on the same problem.

Both solve the fusion problem of one sample, min ½ fᵀ N f − ν₀ᵀ f + γ Σ ‖f_i‖_{N_ii}. Our time is that of a
whole `step`: local filters, covariance, trust and attack estimate included. The rival's time is only that of
setting the parameter ν₀ and solving; its local filters are computed beforehand. The refit is off: it would be
a second problem.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import clarabel
import cvxpy as cp
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.stats import chi2

from benches import plants
from benches.timing import Comparison, Contender, fastest
from securestate import Plant, SparseFusion

Float = NDArray[np.float64]
TOLERANCE = 1e-6
#: Clarabel's tolerances: its own, which are timed, and those of the reference. Always given, because a reused
#: solver remembers its last ones.
DEFAULT = {"tol_gap_abs": 1e-8, "tol_gap_rel": 1e-8, "tol_feas": 1e-8}
TIGHT = dict.fromkeys(DEFAULT, 1e-11)
#: n, m, number of lying sensors, samples that the rival solves in one turn.
SIZES = ((3, 5, 1, 20), (10, 20, 3, 5), (20, 60, 6, 1))
#: Samples before the timed ones, so that the local filters are in steady state.
LEAD = 50
TIMED = 200


@dataclass(frozen=True)
class Setting:
    """One plant, the penalty that lets 95 of 100 benign samples pass, and the problem in plain NumPy."""

    n: int
    m: int

    @cached_property
    def plant(self) -> Plant:
        return plants.plant(self.n, self.m)

    @property
    def gamma(self) -> float:
        return float(np.sqrt(chi2.ppf(0.95 ** (1 / self.m), self.n)))

    @cached_property
    def estimator(self) -> SparseFusion:
        return SparseFusion(self.plant, gamma=self.gamma, refit=False)

    @cached_property
    def scaling(self) -> list[Float]:
        """L_i^{-T} with N_ii = L_i L_iᵀ: f_i = L_i^{-T} g_i makes the penalty a plain norm of g_i."""
        N, n = self.estimator.decomposition.N, self.n
        blocks = [N[i * n : (i + 1) * n, i * n : (i + 1) * n] for i in range(self.m)]
        return [np.linalg.inv(np.linalg.cholesky(block)).T for block in blocks]

    def scaled(self, rows: Float) -> Float:
        """Rows of R^{mn} times the scaling."""
        parts = rows.reshape(len(rows), self.m, self.n)
        return np.einsum("kia,iab->kib", parts, np.array(self.scaling)).reshape(len(rows), -1)

    @cached_property
    def hessian(self) -> Float:
        H = self.scaled(self.scaled(self.estimator.decomposition.N).T)
        return (H + H.T) / 2

    def locals_(self, y: Float) -> Float:
        """ζ of the local filters (12) for every sample, (T, m n)."""
        pair = self.estimator.decomposition.pair
        zeta, rows = np.zeros((self.m, self.n)), []
        for row in y:
            zeta = zeta @ pair.T.T + row[:, np.newaxis] * pair.b
            rows.append(zeta.ravel())
        return np.array(rows)

    def fuse(self, zeta: Float, g: Float) -> Float:
        """Secure estimate x = Σ F_i (ζ_i + f_i)."""
        F = np.hstack(list(self.estimator.decomposition.F))
        f = np.einsum("kib,iab->kia", g.reshape(len(g), self.m, self.n), np.array(self.scaling))
        return (zeta + f.reshape(zeta.shape)) @ F.T

    def measurements(self, liars: int) -> Float:
        """Lies of about twenty standard deviations of the innovation."""
        size = 20.0 * float(np.sqrt(self.estimator.decomposition.steady.innovation_cov.diagonal().max()))
        y = plants.measurements(self.plant, LEAD + TIMED)
        return plants.attacked(y, liars, size) if liars else y


def steps(quick: bool) -> Iterator[Comparison]:
    """One call per sample, as in a live service, attacked and benign."""
    for n, m, liars, count in SIZES[:1] if quick else SIZES:
        setting = Setting(n, m)
        ways: list[Way] = []
        for lying in (liars, 0):
            y = setting.measurements(lying)
            ours, (theirs, precise) = _ours(setting, y, lying > 0), _cvxpy(setting, y, count, ways)
            case = f"sparse step, {'attacked' if lying else 'benign'}"
            size = f"n={n} m={m}" + (f", {lying} lying" if lying else "")
            target = 300.0 if lying and n < 20 else None
            yield Comparison(case, size, ours, theirs, TOLERANCE, target, precise)
            alone = [_clarabel(setting, y, count, tight=tight) for tight in (False, True)]
            yield Comparison(case, size, ours, alone[0], TOLERANCE, None, alone[1])


def design(quick: bool) -> Iterator[Comparison]:
    """Once per plant: from the plant to an estimator."""
    for n, m, *_ in SIZES[:1] if quick else SIZES:
        plant = plants.plant(n, m)

        def work(_: None, plant: Plant = plant) -> Float:
            return np.ones(1) * SparseFusion(plant).plant.n

        yield Comparison("sparse design", f"n={n} m={m}", Contender("securestate", work, 1), None)


def _ours(setting: Setting, y: Float, attacked: bool) -> Contender:
    lead = setting.estimator.start()
    for row in y[:LEAD]:
        lead.step(row)
    blob, rows = lead.save(), list(y[LEAD:])
    if attacked and lead.run(y[LEAD:]).diagnostics["fast_path"].any():
        raise ValueError("an attacked sample is not noticed, so there is nothing to solve")

    def work(live: Any) -> Float:
        step = live.step
        return np.array([estimate.x for estimate in [step(row) for row in rows]])

    return Contender("securestate", work, len(rows), lambda: setting.estimator.resume(blob))


def _cvxpy(setting: Setting, y: Float, count: int, ways: list[Way]) -> tuple[Contender, Contender]:
    """The best of two formulations, with and without reuse of the solver; and the same to full precision.

    The attacked samples of a size, which come first, choose the way for the benign ones too.
    """
    if not ways:
        forms = {"quadratic form": _quadratic(setting), "least squares": _squares(setting)}
        ways += [Way(name, *form, reuse) for name, form in forms.items() for reuse in (True, False)]
    candidates = [_solve(setting, y, count, way, DEFAULT) for way in ways]
    best = candidates[0] if len(candidates) == 1 else fastest(candidates)
    ways[:] = [ways[candidates.index(best)]]
    return best, _solve(setting, y, count, ways[0], TIGHT)


@dataclass(frozen=True, eq=False)
class Way:
    """One way to put the problem to CVXPY."""

    name: str
    problem: cp.Problem
    linear: cp.Parameter
    g: cp.Variable
    reuse: bool


def _quadratic(setting: Setting) -> tuple[cp.Problem, cp.Parameter, cp.Variable]:
    d = setting.n * setting.m
    g, nu = cp.Variable(d), cp.Parameter(d)
    cost = 0.5 * cp.quad_form(g, cp.psd_wrap(setting.hessian)) - nu @ g
    return cp.Problem(cp.Minimize(cost + _penalty(setting, g))), nu, g


def _squares(setting: Setting) -> tuple[cp.Problem, cp.Parameter, cp.Variable]:
    d = setting.n * setting.m
    g, nu = cp.Variable(d), cp.Parameter(d)
    values, V = np.linalg.eigh(setting.hessian)
    root = (V * np.sqrt(np.maximum(values, 0.0))).T
    cost = 0.5 * cp.sum_squares(root @ g) - nu @ g
    return cp.Problem(cp.Minimize(cost + _penalty(setting, g))), nu, g


def _penalty(setting: Setting, g: cp.Variable) -> cp.Expression:
    return setting.gamma * cp.sum(cp.norm(cp.reshape(g, (setting.m, setting.n), order="C"), 2, axis=1))


def _linear(setting: Setting, y: Float, count: int) -> tuple[Float, Float]:
    """ζ and ν₀ = −N ζ in the coordinates g, for the first timed samples."""
    zeta = setting.locals_(y[: LEAD + count])[LEAD:]
    return zeta, setting.scaled(-zeta @ setting.estimator.decomposition.N)


def _solve(setting: Setting, y: Float, count: int, way: Way, options: dict[str, float]) -> Contender:
    zeta, linear = _linear(setting, y, count)

    def work(_: None) -> Float:
        solutions = []
        for nu in linear:
            way.linear.value = nu
            way.problem.solve(cp.CLARABEL, warm_start=way.reuse, presolve_enable=not way.reuse, **options)
            solutions.append(way.g.value)
        return setting.fuse(zeta, np.array(solutions))

    how = "solver reused" if way.reuse else "new solver"
    return Contender(f"CVXPY + Clarabel ({way.name}, {how})", work, count)


def _clarabel(setting: Setting, y: Float, count: int, *, tight: bool) -> Contender:
    """Clarabel without a modelling layer, the same problem with t_i ≥ ‖g_i‖, updated in place."""
    n, m, d = setting.n, setting.m, setting.n * setting.m
    zeta, linear = _linear(setting, y, count)
    P = sparse.block_diag([np.triu(setting.hessian), sparse.csc_array((m, m))], format="csc")
    order = np.concatenate([[d + i, *range(i * n, (i + 1) * n)] for i in range(m)])
    A = -sparse.eye_array(d + m, format="csr")[order].tocsc()
    cones = [clarabel.SecondOrderConeT(n + 1) for _ in range(m)]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.presolve_enable = False, False
    for name, value in TIGHT.items() if tight else ():
        setattr(settings, name, value)
    tail = np.full(m, setting.gamma)
    q = np.concatenate([-linear[0], tail])
    solver = clarabel.DefaultSolver(P, q, A, np.zeros(d + m), cones, settings)

    def work(_: None) -> Float:
        solutions = []
        for nu in linear:
            solver.update(q=np.concatenate([-nu, tail]))
            solutions.append(np.array(solver.solve().x)[:d])
        return setting.fuse(zeta, np.array(solutions))

    return Contender("Clarabel alone (solver reused)", work, count)


CASES: dict[str, Callable[[bool], Iterator[Comparison]]] = {"sparse-step": steps, "sparse-design": design}
