"""`securestate compare`: estimators against adversaries, from a suite file to a table and a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from securestate.cli.exits import Exit


def compare(
    suite: Annotated[Path, typer.Argument(help="What to compare, TOML.")],
    out: Annotated[Path, typer.Option(help="Folder for the results; what it holds is not done again.")],
    report: Annotated[Path | None, typer.Option(help="Write the report: one .html file.")] = None,
    runs: Annotated[int | None, typer.Option(help="Runs per scenario, instead of those in the file.")] = None,
    workers: Annotated[
        int | None, typer.Option(help="Threads, or processes with --dask local (default: one per core).")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Work on a dask cluster: its scheduler's address, or local."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> Exit:
    """Compare estimators under simulated attacks with an oracle that is told who lies.

    The numbers depend on the suite and its seed only, not on who computes them. An interrupted comparison
    goes on where it stopped when it is started again.
    """
    from securestate.cli.campaign import Campaign, run_campaign  # the scientific libraries take a second

    return run_campaign(Campaign(suite, out, report, runs, workers, dask, quiet))
