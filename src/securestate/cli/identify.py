"""`securestate identify`: from attack-free history to a plant file, with a verdict on it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from securestate.cli.exits import Exit
from securestate.cli.names import split_names


def _order(text: str) -> str:
    if text != "auto" and not (text.isascii() and text.isdigit() and int(text) > 0):
        raise typer.BadParameter(f"{text!r} is neither a whole number >= 1 nor auto")
    return text


def identify(
    history: Annotated[
        list[Path],
        typer.Argument(
            help="Records in which no sensor lied: .csv, .tsv, .parquet or .nc.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Write the plant: a .toml file.")],
    inputs: Annotated[
        list[str] | None,
        typer.Option(metavar="NAMES", help="Columns that are inputs: a,b or the option several times."),
    ] = None,
    ignore: Annotated[
        list[str] | None, typer.Option(metavar="NAMES", help="Columns that are neither, in the same way.")
    ] = None,
    channels: Annotated[
        list[str] | None,
        typer.Option(metavar="NAMES", help="Columns that are channels (default: every one that is left)."),
    ] = None,
    tags: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A list of the channels: columns channel, sensor and unit, for names in the plant.",
        ),
    ] = None,
    segment_column: Annotated[
        str | None, typer.Option(metavar="NAME", help="A column whose value tells runs apart.")
    ] = None,
    time_column: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the time column (default: time).")
    ] = None,
    dt: Annotated[
        float | None,
        typer.Option(metavar="S", help="Seconds between samples (default: from the time column, else 1)."),
    ] = None,
    order: Annotated[str, typer.Option(metavar="N|auto", callback=_order, help="Number of states.")] = "auto",
    held_out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Another record, for the verdict; several times (default: the last quarter of the history).",
        ),
    ] = None,
    feedthrough: Annotated[
        bool,
        typer.Option(
            "--feedthrough",
            help="Inputs act within their sample; only if no controller computes them from that sample.",
        ),
    ] = False,
    name: Annotated[str, typer.Option(help="Name of the plant.", show_default=False)] = "",
    report: Annotated[Path | None, typer.Option(help="Write the report: one .html file.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors and warnings.")] = False,
) -> Exit:
    """Learn a plant from history in which no sensor lied, and say how far it can be trusted.

    Ends with 4 if the model is inadequate; the plant is written nonetheless. Example:

    securestate identify january.csv february.csv --held-out march.csv --ignore operator -o plant.toml
    """
    from securestate.cli.learning import (
        Lesson,
        run_lesson,
    )  # the scientific libraries take a second to import

    return run_lesson(
        Lesson(
            history=history,
            out=out,
            inputs=split_names("--inputs", inputs),
            ignore=split_names("--ignore", ignore),
            channels=split_names("--channels", channels) or None,
            tags=tags,
            segment_column=segment_column,
            time_column=time_column,
            dt=dt,
            order="auto" if order == "auto" else int(order),
            held_out=held_out or [],
            feedthrough=feedthrough,
            name=name,
            report=report,
            quiet=quiet,
        )
    )
