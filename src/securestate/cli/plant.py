"""`securestate plant check`: what a plant file says and which estimators it allows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from securestate.cli.exits import Exit


def check(plant: Annotated[Path, typer.Argument(help="Plant file, TOML.")]) -> Exit:
    """Check a plant file: sizes, sensors, modes, and the estimators that can be designed for it.

    Ends with 4 if no estimator can be designed.
    """
    from securestate.cli.inspection import inspect  # the scientific libraries take a second to import

    return inspect(plant)
