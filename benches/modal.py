"""`python -m benches.modal`: sparse fusion with one penalty per sensor against one per sensor and mode.

Plants: Liu's example; random ones with distinct modes where the default's ratio of Theorem 4 is 1 or more for
some number p of liars that an estimator can survive (every flat mode seen by more than 2 p sensors), p the
smallest such number or, with --limit, the largest; two ordinary ones. Lies: constant ones; on the random
plants lies that move as the plant does and end at some direction, so that the liars agree on a wrong state.
Their size is that of the largest of the last readings, in standard deviations of its noise. Errors are mean
squared errors over that of the Kalman filter that never hears the liars: geometric mean and largest over the
cases of a row.

"raised": the penalties of dim sensors are raised only so far that the ratio for p stays below 0.8.
"evened": the default with γ_i in proportion to 1 / ‖G_i‖ and no γ_i lowered.
"fewest": the default and another form side by side. An explanation is plausible if ζᵀ N ζ without the accused
sensors is below its 0.999 quantile; the default's is taken unless the other one is plausible and accuses
fewer sensors, or the default's is not plausible.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.special import gammaincinv

from benches._modal_cases import evened, lies, liu, modal_ratio, moving, ordinary, random_plant, worst
from benches._modal_form import Modal
from securestate import Estimator, KalmanFilter, Plant, SparseFusion

Float = NDArray[np.float64]
RUNS, STEPS, LAST = 20, 40, 5
GROWING, CONSTANT = (5.0, 20.0, 100.0, 1e6), (2.0, 5.0, 20.0)


def simulate(plant: Plant, seed: int) -> tuple[Float, Float, Float]:
    """States, readings and inputs under u = −A x."""
    rng = np.random.default_rng(seed)
    w = rng.standard_normal((RUNS, STEPS, plant.n)) @ np.linalg.cholesky(plant.Q).T
    v = rng.standard_normal((RUNS, STEPS, plant.m)) @ np.linalg.cholesky(plant.R).T
    x = np.concatenate([np.zeros((RUNS, 1, plant.n)), w[:, :-1]], axis=1)
    return x, x @ plant.C.T + v, -x @ plant.A.T


class Rivals:
    """The estimators of a plant for p liars, and their errors on one record."""

    def __init__(self, plant: Plant, liars: int, seed: int) -> None:
        self.plant, self.parts = plant, SparseFusion(plant).decomposition
        self.kalman = KalmanFilter(plant)
        self.forms: dict[str, Estimator] = {
            "default": SparseFusion(plant),
            "modal": Modal(plant),
            "modal, no refit": Modal(plant, refit=False),
            "raised": Modal(plant, liars=liars, margin=0.8),
            "evened": SparseFusion(plant, gamma=evened(plant, self.parts)),
        }
        self.x, self.y, self.u = simulate(plant, seed)

    def honest(self) -> dict[str, tuple[float, float]]:
        """Share of Kalman estimates, and squared error over the Kalman filter's, when nobody lies."""
        kalman = np.mean((self.kalman.run(self.y, self.u, covariance=False).x - self.x) ** 2)
        runs = {name: form.run(self.y, self.u, covariance=False) for name, form in self.forms.items()}
        return {
            name: (float(run.diagnostics["fast_path"].mean()), float(np.mean((run.x - self.x) ** 2) / kalman))
            for name, run in runs.items()
        }

    def errors(self, liars: NDArray[np.int64], lie: Float) -> dict[str, float]:
        y, unheard = self.y + lie, self.y.copy()
        unheard[..., liars] = np.nan
        runs = {name: form.run(y, self.u, covariance=False) for name, form in self.forms.items()}
        square = {name: self._square(run.x) for name, run in runs.items()}
        zeta = self._local(y)
        for name in ("modal", "evened"):
            accused = [runs[each].suspected[:, -LAST:] for each in ("default", name)]
            default, other = (self._left(zeta, who) for who in accused)
            fewer = accused[1].sum(axis=-1) < accused[0].sum(axis=-1)
            better = (other < 1) & (fewer | (default > 1))
            square[f"fewest, {name}"] = np.where(better, square[name], square["default"])
        square["Kalman"] = self._square(self.kalman.run(y, self.u, covariance=False).x)
        oracle = self._square(self.kalman.run(unheard, self.u, covariance=False).x).mean()
        return {name: float(value.mean() / oracle) for name, value in square.items()}

    def _square(self, x: Float) -> Float:
        return np.asarray(np.sum((x - self.x)[:, -LAST:] ** 2, axis=-1))

    def _local(self, y: Float) -> Float:
        """ζ of the last samples, (runs, LAST, m n): (12) and the effect of the input."""
        plant, parts, (runs, m, n) = self.plant, self.parts, (len(y), self.plant.m, self.plant.n)
        split, k = parts.split, parts.split.flat
        B = split.V_inv @ plant.B
        into = parts.G - parts.pair.b[:, None] * (plant.C @ split.V[:, :k])[:, None, :]
        zeta, x_s, out = np.zeros((runs, m, n)), np.zeros((runs, n - k)), []
        for t in range(STEPS):
            zeta += (y[:, t] - x_s @ split.V[:, k:].T @ plant.C.T)[..., None] * parts.pair.b
            out.append(zeta.reshape(runs, m * n))
            zeta = zeta @ parts.pair.T.T + np.einsum("iab,rb->ria", into, self.u[:, t] @ B[:k].T)
            x_s = x_s @ split.A_s.T + self.u[:, t] @ B[k:].T
        return np.stack(out[-LAST:], axis=1)

    def _left(self, zeta: Float, accused: NDArray[np.bool_]) -> Float:
        """ζᵀ N ζ that is left without the accused sensors, over its 0.999 quantile."""
        n, m, N = self.plant.n, self.plant.m, self.parts.N
        nu, left = -zeta @ N, np.empty(zeta.shape[:2])
        rank = np.linalg.matrix_rank(N, tol=1e-9 * np.linalg.norm(N, 2), hermitian=True)
        for who in np.unique(accused.reshape(-1, m), axis=0):
            own, at = np.repeat(who, n), (accused == who).all(axis=-1)
            values, U = np.linalg.eigh(N[np.ix_(own, own)])
            keep = values > 1e-9 * np.linalg.norm(N, 2)
            inside = (nu[at][:, own] @ U[:, keep]) ** 2 / values[keep]
            square = -np.sum(nu[at] * zeta[at], axis=-1) - inside.sum(axis=-1)
            left[at] = square / (2 * gammaincinv(max(rank - keep.sum(), 1) / 2, 0.999))
        return left


Row = tuple[str, dict[str, list[float]]]


def short_of_the_limit(count: int, *, most: bool) -> Iterator[Row]:
    """Random plants and the fewest or most liars p for which the default's ratio is at least 1."""
    rows: dict[str, dict[str, list[float]]] = {}
    seed = plants = 0
    honest: list[dict[str, tuple[float, float]]] = []
    while plants < count:
        seed += 1
        rng = np.random.default_rng(seed)
        plant = random_plant(rng)
        parts, counts = SparseFusion(plant).decomposition, Modal(plant).counts
        limit = (min(counts) - 1) // 2
        ratios = [worst(plant, parts, p) for p in range(1, limit + 1)]
        broken = [p for p, found in enumerate(ratios, 1) if found[0] >= 1]
        if not broken:
            continue
        p = broken[-1 if most else 0]
        plants += 1
        print(f"n={plant.n} N={plant.m} p={p} of {limit}: {compared(plant, p)}")
        rivals = Rivals(plant, p, seed)
        honest.append(rivals.honest())
        for name, liars, u in lies(plant, parts, p, ratios[p - 1], rng):
            lie = moving(plant, parts, liars, u, STEPS)
            for size in GROWING:
                gather(rows.setdefault(f"{name}, {size:g}", {}), rivals.errors(liars, size * lie))
    for name in honest[0]:
        share, cost = np.mean([one[name] for one in honest], axis=0)
        print(f"nobody lies, {name}: Kalman estimate in {share:.3f}, squared error {cost:.4f} of its own")
    yield from rows.items()


def constant(
    plant: Plant, title: str, liars: int, sets: int, sizes: tuple[float, ...] = CONSTANT
) -> Iterator[Row]:
    """Every liar adds the same number of its own standard deviations, with a sign of its own."""
    rng, rivals = np.random.default_rng(liars), Rivals(plant, liars, liars)
    every = list(combinations(range(plant.m), liars))
    chosen = rng.permutation(len(every))[:sets]
    signs = rng.choice([-1.0, 1.0], (sets, plant.m)) * np.sqrt(np.diag(plant.R))
    for size in sizes:
        row: dict[str, list[float]] = {}
        for j, sign in zip(np.sort(chosen), signs, strict=False):
            who = np.array(every[j])
            gather(row, rivals.errors(who, size * sign * np.isin(np.arange(plant.m), who)))
        yield f"{title}, {liars} of {plant.m}, {size:g}", row


def compared(plant: Plant, liars: int) -> str:
    parts = SparseFusion(plant).decomposition
    even = evened(plant, parts)
    ratios = [
        worst(plant, parts, liars)[0],
        modal_ratio(plant, parts, liars),
        worst(plant, parts, liars, even)[0],
    ]
    return "ratio {:.2f}, modal {:.2f}, evened {:.2f}".format(*ratios)


def gather(row: dict[str, list[float]], errors: dict[str, float]) -> None:
    for name, value in errors.items():
        row.setdefault(name, []).append(value)


def show(title: str, rows: list[Row]) -> None:
    grid = Table("lie", *rows[0][1], title=title, box=SIMPLE_HEAD)
    for name, row in rows:
        cells = [f"{np.exp(np.mean(np.log(v))):.3g} / {np.max(v):.3g}" for v in row.values()]
        grid.add_row(name, *cells)
    Console(width=190).print(grid)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        "python -m benches.modal", description="One penalty per sensor and mode?"
    )
    parser.add_argument("--count", type=int, default=12, help="random plants")
    parser.add_argument("--limit", action="store_true", help="as many liars as any estimator survives")
    options = parser.parse_args(arguments)
    print(f"Liu's example, p=1: {compared(liu(), 1)}")
    show("Liu's example", list(constant(liu(), "constant", 1, 5, (*CONSTANT, 100.0))))
    show(
        "Where the default falls short of the limit",
        list(short_of_the_limit(options.count, most=options.limit)),
    )
    for n, N in ((2, 8), (4, 15)):
        rows = [
            row for p in sorted({1, N // 3, (N - 1) // 2}) for row in constant(ordinary(n, N), f"n={n}", p, 8)
        ]
        show(f"An ordinary plant, n={n}", rows)


if __name__ == "__main__":
    main()
