"""`securestate judge`: whether a plant's model is still good on a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from securestate.cli.exits import Exit


def judge(
    plant: Annotated[Path, typer.Argument(help="Plant file, TOML.", show_default=False)],
    data: Annotated[
        list[Path],
        typer.Argument(
            help="Records without lies, other than those it was fitted to: .csv, .tsv, .parquet or .nc.",
            show_default=False,
        ),
    ],
    segment_column: Annotated[
        str | None, typer.Option(metavar="NAME", help="A column whose value tells runs apart.")
    ] = None,
    time_column: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the time column (default: time).")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> Exit:
    """Judge whether a plant's model is good enough, on this record, to judge sensors by.

    Ends with 4 if it is inadequate. Columns that the plant does not name are not used.
    """
    from securestate.cli.judgement import run_judgement  # the scientific libraries take a second to import

    return run_judgement(plant, data, segment_column, time_column, quiet=quiet)
