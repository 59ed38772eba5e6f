"""The work of `securestate compare`: read the suite, compute what is lacking, write tables and report."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from securestate._results import check_folder
from securestate.cli import console
from securestate.cli.exits import Exit
from securestate.errors import InputError
from securestate.simulation import Comparison, campaign
from securestate.simulation.compare import ORACLE
from securestate.simulation.suite import load_suite


@dataclass(frozen=True)
class Campaign:
    """What the user asked for."""

    suite: Path
    out: Path
    report: Path | None
    runs: int | None
    workers: int | None
    dask: str | None
    quiet: bool


def run_campaign(order: Campaign) -> Exit:
    """Do the whole job; what is computed is kept even if the rest is interrupted."""
    if order.report is not None:
        if order.report.suffix.lower() not in (".html", ".htm"):
            raise InputError("--report", "a file name ending in .html", repr(str(order.report)))
        if order.report.parent.resolve() != order.out.resolve():
            check_folder(order.report, "--report")
    suite = load_suite(order.suite, runs=order.runs)
    try:
        with console.steps("comparing", "groups of runs", quiet=order.quiet) as progress:
            result = campaign(
                suite.scenarios,
                suite.recipes,
                workers=order.workers,
                dask=order.dask,
                out=order.out,
                progress=progress,
            )
    except KeyboardInterrupt:
        print(f"what is done is kept in {order.out}; the same command goes on from there", file=sys.stderr)
        raise
    written = result.save(order.out)
    if order.report is not None:
        from securestate.reporting import write_comparison

        title = suite.name or order.suite.stem
        written.append(write_comparison(result, order.report, title=title, source=order.suite.name))
    if not order.quiet:
        _show(result, written)
    return Exit.CLEAN


def _show(result: Comparison, written: Sequence[Path]) -> None:
    """Print the ranking, what could not run, and the files written."""
    shown = console.output()
    shown.print(f"{result!r}, mean squared error over the oracle's (geometric mean over scenarios)")
    shown.print()
    grid = console.table(
        "estimator", "ratio", "worst", "within\n1.5", "false\nalarms", "detected", "µs per\nstep", "runs in"
    )
    grid.columns[0].no_wrap = True
    order = result.ranking
    yardstick = order.index == ORACLE
    for name, row in pd.concat([order[~yardstick], order[yardstick]]).iterrows():
        grid.add_row(
            f"{name} (is told)" if name == ORACLE else str(name),
            *(_number(row[figure]) for figure in ("ratio", "worst")),
            *(_percent(row[figure]) for figure in ("within", "false_alarm_rate", "detection_rate")),
            _number(row["microseconds"]),
            f"{int(row['scenarios'])} of {result.table.sizes['scenario']}",
        )
    shown.print(grid)
    shown.print()
    for line in _refusals(result):
        shown.print(line)
    for path in written:
        shown.print(f"wrote {path}", soft_wrap=True)


def _refusals(result: Comparison) -> list[str]:
    """One line per estimator and reason."""
    reasons: dict[tuple[str, str], int] = {}
    frame = result.table["refusal"].to_pandas()
    for name in frame.columns:
        for reason in frame[name]:
            if reason:
                reasons[str(name), reason] = reasons.get((str(name), reason), 0) + 1
    return [
        f"{name} cannot run in {count} scenario{'' if count == 1 else 's'}: {why}"
        for (name, why), count in reasons.items()
    ]


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.3g} %"
