"""`securestate analyse`: how many liars an installation survives, and what would help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from securestate.cli.exits import Exit


def analyse(
    plant: Annotated[Path, typer.Argument(help="Plant file, TOML.")],
    attacked: Annotated[
        int | None,
        typer.Option(
            metavar="P", help="Plan for so many liars (default: as many as it survives; advice for one more)."
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="T",
            help="Accuracy of the model: what counts as equal and as zero (default: 1e-8; of an identified "
            "model 1e-4 to 1e-3).",
        ),
    ] = None,
    time_limit: Annotated[
        float, typer.Option(metavar="S", help="Seconds, about; the rest is given as bounds.")
    ] = 60.0,
    report: Annotated[Path | None, typer.Option(help="Write the report: one .html file.")] = None,
    improved: Annotated[
        Path | None, typer.Option(help="Write the plant after the first advice: a .toml file.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> Exit:
    """Find how many lying sensors a plant survives, where it is weak, which method fits, and what would help.

    No data is needed. Ends with 4 if no sensor sees some mode, or if the plant certainly survives fewer than
    --attacked. Example:

    securestate analyse plant.toml --attacked 2 --report report.html --improved better.toml
    """
    from securestate.cli.survey import Survey, run_survey  # the scientific libraries take a second to import

    return run_survey(Survey(plant, attacked, tolerance, time_limit, report, improved, quiet))
