"""`python -m benches`: measure, print, and keep the results."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benches import joint, kalman, lasso, machine, mixture, monte_carlo, sparse, table
from benches.timing import Comparison, DisagreementError, Measurement, measure

CASES: dict[str, Callable[[bool], Iterator[Comparison]]] = (
    kalman.CASES | sparse.CASES | lasso.CASES | joint.CASES | mixture.CASES | monte_carlo.CASES
)
ROUNDS, QUICK_ROUNDS = 9, 3
#: Columns of words, which may wrap; the others are numbers. Width of the table in a file or pipe.
WORDS, WIDTH = 3, 200


def main(arguments: list[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    warnings.filterwarnings("ignore", "Solution may be inaccurate")  # the check of the results judges that
    rounds = QUICK_ROUNDS if options.quick else ROUNDS
    names = options.only or list(CASES)
    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    for line in machine.describe():
        console.print(line, highlight=False)
    try:
        measurements = _measure(names, rounds, options.quick)
    except DisagreementError as error:
        print(f"The results differ, so there is nothing to compare. {error}", file=sys.stderr)
        return 1
    _print(measurements, console)
    if names == list(CASES) and not options.quick:
        table.write(measurements, rounds)
        console.print(f"Kept in {table.RESULTS}", highlight=False, soft_wrap=True)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m benches", description="Side-by-side benchmarks on one thread."
    )
    parser.add_argument("--quick", action="store_true", help="smallest sizes, few rounds; keeps nothing")
    parser.add_argument(
        "--only", action="append", choices=list(CASES), metavar="NAME",
        help=f"only this group, may be repeated; keeps nothing. One of {', '.join(CASES)}",
    )  # fmt: skip
    return parser


def _measure(names: list[str], rounds: int, quick: bool) -> list[Measurement]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    results: list[Measurement] = []
    # The bar is drawn between turns only: a thread that draws would count as our time.
    with Progress(*columns, console=Console(stderr=True), auto_refresh=False, transient=True) as progress:
        for name in names:
            task = progress.add_task(name, total=None)
            progress.refresh()
            for comparison in CASES[name](quick):
                progress.update(
                    task, description=f"{name}: {comparison.case}, {comparison.size}", total=rounds
                )
                progress.reset(task, start=True)

                def after_round(task=task) -> None:
                    progress.advance(task)
                    progress.refresh()

                results.append(measure(comparison, rounds, after_round))
            progress.remove_task(task)
    return results


def _print(measurements: list[Measurement], console: Console) -> None:
    grid = Table(box=SIMPLE_HEAD, padding=(0, 2, 0, 0))
    for position, column in enumerate(table.COLUMNS):
        words = position < WORDS
        grid.add_column(column, justify="left" if words else "right", no_wrap=not words)
    for measurement in measurements:
        grid.add_row(*table.row(measurement))
    console.print(grid)


if __name__ == "__main__":
    sys.exit(main())
