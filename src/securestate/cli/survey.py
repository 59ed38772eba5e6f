"""The work of `securestate analyse`: read the plant, analyse it, print it, write report and better plant."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from securestate._results import check_folder
from securestate.analysis import Resilience, analyse
from securestate.cli import console
from securestate.cli.exits import Exit
from securestate.errors import InputError
from securestate.plant import Plant
from securestate.reporting import write_resilience
from securestate.reporting.resilience_figures import seen_by, survived
from securestate.resilience.eigenspaces import TOLERANCE

ROWS = 12  # modes in the table


@dataclass(frozen=True)
class Survey:
    """What the user asked for."""

    plant: Path
    attacked: int | None
    tolerance: float | None
    time_limit: float
    report: Path | None
    improved: Path | None
    quiet: bool


def run_survey(order: Survey) -> Exit:
    """Do the whole job; nothing is written before all is computed."""
    _check(order)
    plant = Plant.load(order.plant)
    with console.working("analysing", quiet=order.quiet):
        found = analyse(
            plant,
            order.attacked,
            tol=TOLERANCE if order.tolerance is None else order.tolerance,
            time_limit=order.time_limit,
        )
    with console.working("writing", quiet=order.quiet):
        written = list(_write(found, order))
    if order.improved is not None and not found.options:
        print(f"{order.improved} is not written: {_nothing(found)}", file=sys.stderr)
    if not order.quiet:
        _show(found, order.plant, written)
    return _verdict(found, order.attacked)


def _check(order: Survey) -> None:
    """Refuse places that cannot be written before anything is computed."""
    if order.report is not None:
        if order.report.suffix.lower() not in (".html", ".htm"):
            raise InputError("--report", "a file name ending in .html", repr(str(order.report)))
        check_folder(order.report, "--report")
    if order.improved is not None:
        if order.improved.suffix != ".toml":
            raise InputError("--improved", "a file name ending in .toml", repr(str(order.improved)))
        check_folder(order.improved, "--improved")
        if order.improved.resolve() == order.plant.resolve():
            raise InputError("--improved", "another file than the plant's", repr(str(order.improved)))


def _write(found: Resilience, order: Survey) -> Iterator[str]:
    """Write the files; yields what to say about each."""
    if order.report is not None:
        yield f"wrote {write_resilience(found, order.report, source=order.plant.name)}"
    if order.improved is not None and found.options:
        first = found.options[0]
        first.plant.save(order.improved)
        yield f"wrote {order.improved} ({first})"


def _nothing(found: Resilience) -> str:
    """Why there is no better plant."""
    if found.limit.unlimited or found.max_attacked >= found.goal:
        return "nothing has to change"
    return f"no change of few sensors was found that survives {found.goal}"


def _show(found: Resilience, path: Path, written: list[str]) -> None:
    shown = console.output()
    if not found.plant.name:
        shown.print(f"{path.name}:")
    shown.print(str(found), soft_wrap=True)
    shown.print()
    shown.print(_modes(found))
    left = len(found.view.modes) - ROWS
    if left > 0:
        shown.print(f"{left} more")
    if written:
        shown.print()
    for line in written:
        shown.print(line, soft_wrap=True)


def _modes(found: Resilience) -> Table:
    """The weakest modes, one a line."""
    grid = console.table("mode", "seen by", "survives")
    for row, mode in enumerate(found.view.modes[:ROWS]):
        weak = not found.limit.unlimited and found.view.survives[row] <= 0
        cells = (seen_by(found.view, row), survived(found.view, row))
        grid.add_row(str(mode), *cells, style="bold red" if weak else None)
    return grid


def _verdict(found: Resilience, attacked: int | None) -> Exit:
    """Whether the plant certainly survives less than it should."""
    limit = found.limit
    wanted = 0 if attacked is None or limit.unlimited else attacked
    return Exit.DESIGN if limit.max_attacked_upper < wanted else Exit.CLEAN
