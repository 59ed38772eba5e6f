"""`python -m benches.resilience`: how long the limit of an installation takes, beside the programme one would
write.

The textbook way to the fewest sensors that see a direction: for every state j an integer programme in v and
    z,

    min sum of z   subject to   |C_i v| <= M_i z_i,   v_j = 1,   |v| <= 1,   M_i = sum of |C_ij|.

Both run in the same process, one after the other, on one thread. The peer is left out where it would take
minutes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.optimize import Bounds, LinearConstraint, milp

from securestate import Plant, Sensor
from securestate.resilience import Limit, limit

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples" / "power-grids"))

from grids import dc_grid

Float = NDArray[np.float64]
COLUMNS = ("plant", "n", "m", "seen by", "survives", "method", "seconds", "programme", "ratio")


def big_m(C: Float) -> float:
    """The least number of rows that see a direction of the whole space, by one programme per state."""
    m, n = C.shape
    most = np.abs(C).sum(axis=1)
    best = np.inf
    for j in range(n):
        upper, lower = np.ones(n), -np.ones(n)
        lower[j] = 1.0
        seen = np.block([[C, -np.diag(most)], [-C, -np.diag(most)]])
        answer = milp(
            np.r_[np.zeros(n), np.ones(m)],
            constraints=LinearConstraint(seen, -np.inf, 0.0),
            integrality=np.r_[np.zeros(n), np.ones(m)].astype(np.int64),
            bounds=Bounds(np.r_[lower, np.zeros(m)], np.r_[upper, np.ones(m)]),
        )
        best = min(best, round(answer.fun))
    return best


def distinct(n: int) -> Plant:
    """As many sensors as states, all modes simple; a tenth of C is not zero."""
    rng = np.random.default_rng(0)
    C = rng.standard_normal((n, n)) * (rng.random((n, n)) < 0.1) + np.eye(n)
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    return Plant(A, np.eye(n), [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(C)])


def dense(n: int, m: int) -> Plant:
    """One eigenspace and dense rows: bounds that do not meet."""
    C = np.random.default_rng(0).standard_normal((m, n))
    return Plant(np.eye(n), np.eye(n), [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(C)])


def timed(work: Callable[[], object]) -> tuple[float, object]:
    """Seconds, and what came out."""
    start = perf_counter()
    found = work()
    return perf_counter() - start, found


def row(name: str, plant: Plant, *, peer: bool, time_limit: float) -> list[str]:
    """One line of the table."""
    seconds, found = timed(lambda: limit(plant, 0.0, time_limit=time_limit))
    assert isinstance(found, Limit)
    seen = f"{found.lower:.0f}" if found.lower == found.upper else f"{found.lower:.0f} to {found.upper:.0f}"
    survives = (
        f"{found.max_attacked}" if found.exact else f"{found.max_attacked} to {found.max_attacked_upper}"
    )
    method = "" if found.weakest is None else found.weakest.method
    cells = [name, f"{plant.n}", f"{plant.m}", seen, survives, method, f"{seconds:.3f}"]
    if not peer:
        return [*cells, "-", "-"]
    theirs, count = timed(lambda: big_m(plant.C))
    assert count == found.upper == found.lower
    return [*cells, f"{theirs:.2f}", f"{theirs / seconds:.0f}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="time the limit of an installation")
    parser.add_argument("--time-limit", type=float, default=10.0, help="seconds for the dense case")
    wanted = parser.parse_args()
    table = Table(*COLUMNS, box=SIMPLE_HEAD)
    dc_grid("case14")  # imports
    for case in ("case14", "case39", "case118", "case300"):
        table.add_row(*row(case, dc_grid(case), peer=case in ("case14", "case39"), time_limit=60.0))
    table.add_row(*row("simple modes", distinct(200), peer=False, time_limit=60.0))
    table.add_row(*row("dense, one mode", dense(12, 40), peer=False, time_limit=wanted.time_limit))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
