"""Lists of names on the command line."""

from __future__ import annotations

import csv
from collections.abc import Sequence

import typer


def split_names(option: str, given: Sequence[str] | None) -> tuple[str, ...]:
    """Names of an option that may come several times, each time with several names between commas.

    A name that holds a comma stands in double quotes, as in a CSV file.

    Examples:
        >>> split_names("--inputs", ["valve, pump", '"heater, left"'])
        ('valve', 'pump', 'heater, left')
    """
    try:
        rows = list(csv.reader(given or [], skipinitialspace=True, strict=True))
    except csv.Error as reason:
        raise typer.BadParameter(f"{option}: {reason}") from None
    names = tuple(name.strip() for row in rows for name in row)
    if given and not all(names):
        raise typer.BadParameter(f"{option}: a name is empty")
    return names
