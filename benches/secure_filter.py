"""`python -m benches.secure_filter`: every estimator in every cell of plants and attacks, beside the oracle.

A cell is a plant, an attack and how many sensors lie (`_secure_cells.py`): 30 clean samples, then 100 under
attack, over which the squared error is averaged. The number that counts is the mean squared error over that
of the oracle, the Kalman filter that is told who lies, on the same runs. A run depends on its seed and on its
cell only. In a cold cell nothing is known at the first attacked sample: every method starts from a window of
samples (`run(y, prior="window")`), whose smoothed states count too, the oracle from a wide belief.

--limit adds, in cells of scalar plants whose liars change at every sample, the exact Bayesian estimates of
`_secure_limit.py`: which of these cells leave room for a better method, and which do not.

Nothing is kept without --out. With it, the file is written anew after every cell, and --resume goes on with
the cells that it lacks; say so only if the estimators have not changed since.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from threadpoolctl import threadpool_limits

from benches import _secure_table, machine, table
from benches._secure_cells import CELLS, Cell
from benches._secure_limit import CELLS_WITH_LIMIT, WAYS
from benches._secure_methods import JUDGED, ORACLE, PARTS, methods, runs_of, variant
from benches._secure_score import KEPT, Result, Results, attempt, join

#: Runs handed to a process at a time.
CHUNK = 5
WIDTH = 200


@dataclass(frozen=True)
class Plan:
    """What is asked for."""

    cells: Sequence[Cell]
    names: Sequence[str]
    runs: int
    first_seed: int

    @property
    def settings(self) -> dict[str, object]:
        """What decides numbers, beside the estimators themselves."""
        return {"runs": self.runs, "first_seed": self.first_seed, "methods": list(self.names)}

    def tasks(self, cell: Cell) -> Iterator[partial[Results]]:
        """The runs of a cell in small portions."""
        for low in range(0, self.runs, CHUNK):
            yield partial(work, self, cell, range(low, min(low + CHUNK, self.runs)))


def work(plan: Plan, cell: Cell, numbers: range) -> Results:
    """Some runs of a cell."""
    share = {name: runs_of(name, cell, plan.runs) for name in plan.names}
    return join(
        [attempt(cell, plan.first_seed + r, [n for n in plan.names if r < share[n]]) for r in numbers]
    )


def main(arguments: list[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    known = methods()
    unknown = [name for name in options.methods or () if variant(name) is None]
    cells = [
        cell for cell in (CELLS_WITH_LIMIT if options.limit else CELLS) if re.search(options.cells, cell.name)
    ]
    if unknown or not cells:
        what = f"methods {', '.join(unknown)}" if unknown else f"cell as {options.cells!r}"
        print(f"No such {what}. Methods: {', '.join(known)}.", file=sys.stderr)
        return 2
    ablated = [JUDGED, *(f"{JUDGED} without {part}" for part in PARTS)]
    few = ablated if options.ablate else [JUDGED] if options.limit else None
    chosen = options.methods or few or known
    names = list(dict.fromkeys([ORACLE, *chosen, *(WAYS if options.limit else ())]))
    plan = Plan(cells, names, options.runs, options.first_seed)
    done = read(options.out, plan) if options.resume else {}
    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    for line in machine.describe():
        console.print(line, highlight=False)
    whole = True
    try:
        for cell, results in measured(plan, options.processes, done):
            done[cell.name] = results
            _print(cell.name, _secure_table.CELL_COLUMNS, _secure_table.cell_rows(results), console)
            if options.out:
                write(options.out, plan, done)
    except KeyboardInterrupt:
        whole = False
    _finish(done, JUDGED if JUDGED in names else names[len(names) > 1], plan)
    return 0 if whole else 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m benches.secure_filter", description="Every estimator in every cell of plants and attacks."
    )
    parser.add_argument("--runs", type=int, default=40, help="runs of each cell (40)")
    parser.add_argument(
        "--first-seed", type=int, default=0, help="seed of the first run; the next has the next"
    )
    parser.add_argument(
        "--cells",
        default="",
        metavar="PATTERN",
        help="only cells in whose name this regular expression is found",
    )
    parser.add_argument(
        "--methods",
        type=lambda text: text.split(","),
        help="only these, comma between; settings as in gate:false_alarm_rate=.1",
    )
    parser.add_argument("--ablate", action="store_true", help="the secure filter without each of its parts")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="keep the numbers of every run")
    parser.add_argument(
        "--limit", action="store_true", help="also what no estimator can beat, where that can be computed"
    )
    parser.add_argument(
        "--resume", action="store_true", help="keep the cells that --out has, do not repeat them"
    )
    return parser


def measured(plan: Plan, processes: int, done: Mapping[str, Results]) -> Iterator[tuple[Cell, Results]]:
    """Every cell that is not done, in order, with all its runs."""
    cells = [cell for cell in plan.cells if cell.name not in done]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with (
        Progress(*columns, console=Console(stderr=True), transient=True) as progress,
        _pool(processes) as pool,
    ):
        task = progress.add_task("", total=len(cells))
        waiting = [(cell, [_submit(pool, one) for one in plan.tasks(cell)]) for cell in cells]
        for cell, parts in waiting:
            progress.update(task, description=cell.name)
            yield cell, join([part.result() if isinstance(part, Future) else part() for part in parts])
            progress.advance(task)


def _submit(pool: ProcessPoolExecutor | None, one: partial[Results]) -> Future[Results] | partial[Results]:
    return one if pool is None else pool.submit(one)


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor | None]:
    """Processes with one thread each; none if one is enough."""
    if processes < 2:
        with threadpool_limits(1, "blas"):
            yield None
        return
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_alone)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _alone() -> None:
    threadpool_limits(1, "blas")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process stops the others


def _print(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], console: Console) -> None:
    grid = Table(*columns, box=SIMPLE_HEAD, title=title, title_justify="left")
    for row in rows:
        grid.add_row(*row)
    console.print(grid)


def _finish(done: Mapping[str, Results], judge: str, plan: Plan) -> None:
    lacking = sum(cell.name not in done for cell in plan.cells)
    print(f"{len(done)} cells, {plan.runs} runs each from seed {plan.first_seed} on; {lacking} are lacking.")
    few = {
        name: n
        for cell in plan.cells
        for name in plan.names
        if (n := runs_of(name, cell, plan.runs)) < plan.runs
    }
    for name, n in few.items():
        print(f"{name} is slow to design: {n} runs where every run has its own plant.")
    if done:
        print(_secure_table.report(done, judge))


def write(path: Path, plan: Plan, done: Mapping[str, Results]) -> None:
    """Keep the numbers of all cells done, whole or not at all; infinity and NaN are words."""
    cells = {line: {name: asdict(one) for name, one in results.items()} for line, results in done.items()}
    table.keep(json.dumps({"settings": plan.settings, "columns": KEPT, "cells": cells}) + "\n", path)


def read(path: Path | None, plan: Plan) -> dict[str, Results]:
    """The cells of a file that was made with the same settings; none if there is no file."""
    if path is None or not path.exists():
        return {}
    kept = json.loads(path.read_text(encoding="utf-8"))
    if kept["settings"] != plan.settings:
        raise SystemExit(f"{path} was made with other settings: {kept['settings']}")
    return {
        line: {name: Result(**one) for name, one in results.items()}
        for line, results in kept["cells"].items()
    }


if __name__ == "__main__":
    sys.exit(main())
