"""`python -m benches.identification`: learn random plants that are known, and judge them by fresh samples.

Of every plant 5,000 samples are learned from, and 5,000 more judge: prediction errors over what the plant
says (1 is right), and the loss of variance explained one step ahead against the true model, in points, of the
worst channel. `independent`: truths with independent noises. `general`: noises that sensors share with each
other and with what drives the state; there the loss of the innovations form, which is kept beside the plant,
counts, too.

`--large` learns 100 channels of 100,000 samples. Rows are kept in a file as they come, so that an interrupted
run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import csv
import resource
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy import linalg

from benches._systems import Truth, dynamics, general, independent_noises, record
from securestate import Plant, SecurestateWarning, identify
from securestate._steady_state import steady_state
from securestate.identification.forms import Independent, Innovations, Predictor, Stack, innovations_of
from securestate.identification.residuals import residuals

Float = NDArray[np.float64]

KINDS = {"independent": independent_noises, "general": general}
LEARNED, JUDGED, SETTLED = 5000, 5000, 100
COLUMNS = ("seed", "n", "m", "q", "order", "grade", "size", "loss", "loss_innovations", "cost", "seconds")


def explained(form: Innovations, y: Float, u: Float) -> Float:
    """Share of every channel's variance that is predicted one step ahead, (m,)."""
    e, _ = Predictor(form)(Stack([(y, u)]))
    return 1 - e[SETTLED:].var(axis=0) / y[SETTLED:].var(axis=0)


def form_of(plant: Plant) -> Innovations:
    """The law of the plant's channels."""
    steady = steady_state(plant)
    return Innovations(plant.A, plant.B, plant.C, plant.D, plant.A @ steady.gain, steady.innovation_cov)


def trial(truth: Truth, seed: int, rng: np.random.Generator) -> dict[str, object]:
    """Learn one plant and judge it."""
    y, u = record(truth.form, LEARNED + JUDGED, rng)
    m, q = y.shape[1], u.shape[1]
    start = time.process_time()
    found = identify(y[:LEARNED], u[:LEARNED] if q else None)
    seconds = time.process_time() - start
    plant, fresh = found.plant, (y[LEARNED:], u[LEARNED:])
    true = explained(truth.form, *fresh)
    scaled = (plant.normalise(fresh[0]), plant.normalise_input(fresh[1]))
    return {
        "seed": seed,
        "n": truth.form.n,
        "m": m,
        "q": q,
        "order": plant.n,
        "grade": str(found.verdict.grade),
        "size": residuals(plant, [fresh]).size,
        "loss": 100 * float(np.max(true - explained(form_of(plant), *scaled))),
        "loss_innovations": 100 * float(np.max(true - explained(found.innovations, *scaled))),
        "cost": found.search.cost / m,
        "seconds": seconds,
    }


def campaign(kind: str, systems: int, first: int, folder: Path) -> list[dict[str, str]]:
    """One row per system; those in the file already are not made again."""
    path = folder / f"{kind}.csv"
    rows = list(csv.DictReader(path.open())) if path.exists() else []
    done = {int(row["seed"]) for row in rows}
    wanted = [seed for seed in range(first, first + systems) if seed not in done]
    with path.open("a", newline="") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        if not rows:
            writer.writeheader()
        for seed in track(wanted, f"{kind} noises", console=Console(stderr=True)):
            rng = np.random.default_rng(seed)
            writer.writerow(trial(KINDS[kind](rng), seed, rng))
            stream.flush()
    chosen = range(first, first + systems)
    return [row for row in csv.DictReader(path.open()) if int(row["seed"]) in chosen]


def summary(kind: str, rows: list[dict[str, str]]) -> Table:
    """Medians and ranges."""
    table = Table(title=f"{len(rows)} systems, {kind} noises", box=SIMPLE_HEAD, title_justify="left")
    for heading in ("", "median", "95 % of them", "all"):
        table.add_column(heading)
    size = np.array([float(row["size"]) for row in rows])
    low, high = np.quantile(size, [0.025, 0.975])
    table.add_row(
        "errors over what the plant says",
        f"{np.median(size):.3f}",
        f"{low:.3f} to {high:.3f}",
        f"{size.min():.3f} to {size.max():.3f}",
    )
    losses = {"loss": "loss of the plant, points"}
    if kind == "general":
        losses |= {
            "loss_innovations": "loss of the innovations form, points",
            "cost": "cost, nats per channel",
        }
    for column, name in {**losses, "seconds": "seconds of processor time"}.items():
        values = np.array([float(row[column]) for row in rows])
        table.add_row(
            name,
            f"{np.median(values):.3g}",
            f"up to {np.quantile(values, 0.95):.3g}",
            f"up to {values.max():.3g}",
        )
    return table


def large() -> str:
    """Learn a large plant; say how long it took and how much memory."""
    rng = np.random.default_rng(1)
    n, m, N = 20, 100, 100_000
    A, C, G = dynamics(rng, n), rng.standard_normal((m, n)), rng.standard_normal((n, 15))
    Q = G @ G.T / n + 1e-3 * np.eye(n)
    X = linalg.solve_discrete_lyapunov(A, Q)
    r = np.einsum("ij,jk,ik->i", C, X, C) * 10 ** rng.uniform(-1.5, 0.5, m)
    nothing = np.zeros((n, 0)), np.zeros((m, 0))
    y, _ = record(innovations_of(Independent(A, nothing[0], C, nothing[1], Q, r)), N, rng)
    start = time.process_time()
    found = identify(y)
    seconds = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    cost = f"{seconds:.0f} s of processor time, {memory:.2f} GB at most"
    return f"{m} channels x {N:,} samples: {found.plant}, {cost}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m benches.identification", description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=200, help="of each kind (default: 200)")
    parser.add_argument("--first", type=int, default=1000, help="seed of the first (default: 1000)")
    parser.add_argument("--kind", choices=[*KINDS, "both", "none"], default="both")
    parser.add_argument("--large", action="store_true", help="learn 100 channels of 100,000 samples, too")
    parser.add_argument("--out", type=Path, default=Path("identification-bench"), help="folder for the rows")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore", SecurestateWarning)
    options.out.mkdir(parents=True, exist_ok=True)
    console = Console(width=None if sys.stdout.isatty() else 120)
    kinds = {"both": list(KINDS), "none": []}.get(options.kind, [options.kind])
    for kind in kinds:
        console.print(summary(kind, campaign(kind, options.systems, options.first, options.out)))
    if options.large:
        console.print(large(), highlight=False)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
