"""Measurements as rows, and the file that keeps them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import NamedTemporaryFile

from benches import machine
from benches.timing import Measurement

COLUMNS = ("case", "size", "against", "ours µs", "theirs µs", "ratio", "min–max", "target", "difference")
RESULTS = Path(__file__).parent / "results.md"
ABOUT = """# Benchmarks

Written by `make bench`. Times are per sample, medians of {rounds} rounds in which both sides take turns
in one process, on the same data, after a warm-up and a check that both compute the same state. The ratio
is theirs / ours: the median over the rounds, and its range. The difference is the largest one between
both states, relative to the largest number. All sides use one thread (BLAS and ours); times are CPU
times, so that other programs do not count.

- Kalman: equal to 1e-8. Everyone starts from the same wide belief, so the gains settle only on the way.
  Our step also reports standard deviations, likelihood, innovations and trust, live also the covariance.
  statsmodels runs time invariant, with its check for convergence, storing only the filtered state,
  without its results object, in the fastest of its filter methods. NumPy is a filter written by hand; for
  batches it carries all runs in one matrix, shares the gains and keeps only the state.
- Sparse: Clarabel with tolerances of 1e-11 equals ours to 1e-6 in the state; timed is its default of
  1e-8, whose error is in the last column. Our time is a whole step; theirs is the solution alone, with
  parameter and solver set up beforehand. CVXPY gets the fastest of two formulations, with or without
  reuse of the solver. Ours is timed over 200 samples, theirs over the first of them: 20, 5 and 1 by size.
- LASSO: the solver alone, warm-started from sample to sample, on attacked samples. OSQP runs at a
  tolerance of 1e-8 in the faster of two formulations; CVXPY as above.
- Joint fusion: equal to 1e-8 to a loop in NumPy with the same stored gains. Kalman is our own filter on all
  channels, another method; the step of joint fusion contains a Kalman filter of the protected sensors, which
  tests the others. "Recursion" is a step while a channel is missing, when gains and weights are computed
  anew: it grows by the square of the number r of sensors that may lie, and with the rank of what their
  estimates differ in by up to its cube.
- Monte Carlo: trajectories are drawn, measured and filtered; filterpy gets the same random numbers in the
  loop that one writes with it. The comparison as in a paper is ten estimators against five adversaries,
  simulation and all scores included, per sample of one estimator.
"""


def row(measurement: Measurement) -> tuple[str, ...]:
    """One line of the table."""
    comparison = measurement.comparison
    ours = _micro(median(measurement.ours))
    if comparison.theirs is None:
        return comparison.case, comparison.size, "—", ours, "—", "—", "—", "—", "—"
    ratios = measurement.ratios
    return (
        comparison.case,
        comparison.size,
        comparison.theirs.name,
        ours,
        _micro(median(measurement.theirs)),
        _short(measurement.ratio),
        f"{_short(min(ratios))}–{_short(max(ratios))}",
        _verdict(measurement),
        f"{measurement.difference:.0e}" if comparison.alike else "—",
    )


def _verdict(measurement: Measurement) -> str:
    target = measurement.comparison.target
    if target is None:
        return ""
    return f"≥ {target:g}: {'met' if measurement.ratio >= target else 'missed'}"


def _micro(seconds: float) -> str:
    return _short(1e6 * seconds)


def _short(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:,.0f}"


def write(measurements: Sequence[Measurement], rounds: int, path: Path = RESULTS) -> None:
    """Keep the results, whole or not at all."""
    rows = [row(measurement) for measurement in measurements]
    text = "\n".join(
        [
            ABOUT.format(rounds=rounds),
            "## Machine",
            *(f"- {line}" for line in machine.describe()),
            "",
            "## Results",
            *markdown(COLUMNS, rows),
            "",
        ]
    )
    keep(text, path)


def markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table."""
    return [f"| {' | '.join(line)} |" for line in (columns, ["---"] * len(columns), *rows)]


def keep(text: str, path: Path) -> None:
    """Write a file, whole or not at all."""
    with NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8") as file:
        file.write(text)
    Path(file.name).chmod(0o644)
    os.replace(file.name, path)
