"""`python -m benches.cold_start`: how often the cold start finds exactly who lies, and how long it takes.

Fresh random instances of the sizes of the literature. A has 30 % of entries, the largest eigenvalue on the
unit circle; C has 30 %; Q = R = 1e-4 I; x[0] ~ N(0, 100 I). Liars add N(0, 20^2) to every reading. Fixed sets
are the same sensors throughout, changing ones are drawn anew at every sample. "exact" is the share of
instances in which exactly the readings of liars are distrusted. "wrong" counts certified ones whose state
after the window is off beyond its 1e-6 quantile, or, for fixed sets, in which a liar is believed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from time import process_time

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.stats import chi2

from securestate import ColdStart, Plant, Sensor, cold_start

Float = NDArray[np.float64]
#: n, N, liars.
FIXED = ((20, 20, 6), (50, 50, 15), (100, 100, 30), (200, 200, 60), (50, 150, 74), (150, 20, 5))
CHANGING = ((20, 20, 6), (50, 50, 15), (20, 60, 20), (50, 150, 45))
VARIANCE, START, LIE = 1e-4, 10.0, 20.0
COLUMNS = ("set", "n", "N", "liars", "instances", "exact", "certified", "wrong", "samples", "seconds")


@dataclass(frozen=True)
class Instance:
    """A record of `steps` samples; liars (steps, N) says who lies when, x (steps + 1, n) the states."""

    plant: Plant
    y: Float
    x: Float
    liars: NDArray[np.bool_]


def instance(n: int, N: int, liars: int, seed: int, *, fixed: bool) -> Instance:
    rng = np.random.default_rng([seed, n, N, fixed])
    A = rng.standard_normal((n, n)) * (rng.random((n, n)) < 0.3)
    A /= np.abs(np.linalg.eigvals(A)).max()
    C = rng.standard_normal((N, n)) * (rng.random((N, n)) < 0.3)
    C[~C.any(axis=1), 0] = 1.0
    plant = Plant(A, VARIANCE * np.eye(n), [Sensor(f"s{i}", C=C[i], R=VARIANCE) for i in range(N)])
    steps = 2 * max(4, int(np.ceil(1.5 * n / (N - (N - 1) // 2))))
    x = np.empty((steps + 1, n))
    x[0] = START * rng.standard_normal(n)
    for k in range(steps):
        x[k + 1] = A @ x[k] + np.sqrt(VARIANCE) * rng.standard_normal(n)
    chosen = rng.random((1 if fixed else steps, N)).argsort(axis=1) < liars
    lying = np.broadcast_to(chosen, (steps, N))
    y = x[:-1] @ C.T + np.sqrt(VARIANCE) * rng.standard_normal((steps, N))
    return Instance(plant, y + LIE * lying * rng.standard_normal((steps, N)), x, lying)


def wrong(one: Instance, first: ColdStart) -> bool:
    if not first.certified:
        return False
    assert first.belief.P is not None
    error = first.belief.x - one.x[first.samples]
    off = error @ np.linalg.solve(first.belief.P, error) > chi2.isf(1e-6, one.plant.n)
    believed = first.honest & one.liars[0] if first.attacked == "fixed" else np.zeros(1)
    return bool(off or believed.any())


def row(n: int, N: int, liars: int, *, fixed: bool, attacked: str, count: int) -> tuple[str, ...]:
    exact = certified = mistakes = 0
    samples, seconds = [], []
    for seed in range(count):
        one = instance(n, N, liars, seed, fixed=fixed)
        begin = process_time()
        first = cold_start(one.plant, one.y, attacked=attacked)
        seconds.append(process_time() - begin)
        exact += np.array_equal(first.suspected, one.liars[: first.samples])
        certified += first.certified
        mistakes += wrong(one, first)
        samples.append(first.samples)
    used = f"{min(samples)}" if min(samples) == max(samples) else f"{min(samples)}–{max(samples)}"
    shares = f"{exact / count:.0%}", f"{certified / count:.0%}"
    kind = f"{'fixed' if fixed else 'changing'}, asked for {attacked}"
    return (
        kind,
        str(n),
        str(N),
        str(liars),
        str(count),
        *shares,
        str(mistakes),
        used,
        f"{np.median(seconds):.3g}",
    )


def rows(count: int, quick: bool) -> Iterator[tuple[str, ...]]:
    for n, N, liars in FIXED[:2] if quick else FIXED:
        yield row(n, N, liars, fixed=True, attacked="fixed", count=count)
    for n, N, liars in FIXED[:2]:
        yield row(n, N, liars, fixed=True, attacked="any", count=count)
    for attacked in ("changing", "any"):
        for n, N, liars in CHANGING[:1] if quick else CHANGING:
            yield row(n, N, liars, fixed=False, attacked=attacked, count=count)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m benches.cold_start", description="Who is found, how fast.")
    parser.add_argument("--count", type=int, default=100, help="instances of each size")
    parser.add_argument("--quick", action="store_true", help="small sizes, few instances")
    options = parser.parse_args(arguments)
    grid = Table(*COLUMNS, box=SIMPLE_HEAD)
    for line in rows(3 if options.quick else options.count, options.quick):
        grid.add_row(*line)
        print("\t".join(line), flush=True)
    Console(width=120).print(grid)


if __name__ == "__main__":
    main()
