"""A program's numbers beside the paper's and the expected ones: judged, printed, and kept in README.md.

A reproduction is a folder that holds its program, README.md and expected.json:

    |ours - expected| <= abs + rel |expected| + sigma * standard error,

where 'paper' of a row is what the paper says, as words and as a number with the tolerance of its words.
"""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

BEGIN, END = "<!-- begin: written by the program -->", "<!-- end -->"


@dataclass(frozen=True)
class Value:
    """A number of ours and its Monte Carlo standard error (0 if it comes without chance)."""

    number: float
    error: float = 0.0


@dataclass(frozen=True)
class Row:
    """One quantity: what we get, what expected.json demands, what the paper says.

    Attributes:
        section, quantity: where it stands. `column` is "" in a list; rows with columns make a grid.
        value: ours, with its Monte Carlo standard error.
        expected: the number to reproduce; `tolerance` already holds the Monte Carlo part.
        paper: the paper's words, or "" if it says nothing.
        reproduces: whether ours is the paper's number; None if it says nothing.
    """

    section: str
    quantity: str
    column: str
    value: Value
    expected: float
    tolerance: float
    paper: str
    reproduces: bool | None

    @property
    def holds(self) -> bool:
        """Whether the expected number came out."""
        return abs(self.value.number - self.expected) <= self.tolerance

    @property
    def ours(self) -> str:
        """Our number with its standard error."""
        return _text(self.value.number) + (f" ± {_error(self.value.error)}" if self.value.error else "")

    @property
    def demanded(self) -> str:
        """The expected number, loud if ours is not it."""
        return _text(self.expected) + ("" if self.holds else f" ± {self.tolerance:.1g} VIOLATED")


@dataclass(frozen=True)
class Sheet:
    """One section as text: a list with a row per quantity, or a grid with a column per form besides."""

    title: str
    header: list[str]
    lines: list[list[str]]


def sheets(rows: list[Row]) -> Iterator[Sheet]:
    """All sections."""
    for title in dict.fromkeys(row.section for row in rows):
        part = [row for row in rows if row.section == title]
        yield _grid(title, part) if part[0].column else _list(title, part)


def _list(title: str, rows: list[Row]) -> Sheet:
    verdict = {True: "yes", False: "NO", None: ""}
    lines = [[row.quantity, row.paper, row.ours, row.demanded, verdict[row.reproduces]] for row in rows]
    return Sheet(title, ["quantity", "paper says", "we get", "expected", "reproduces"], lines)


def _grid(title: str, rows: list[Row]) -> Sheet:
    columns = list(dict.fromkeys(row.column for row in rows))
    cell = {(row.quantity, row.column): f"{row.ours} ({row.demanded})" for row in rows}
    names = list(dict.fromkeys(row.quantity for row in rows))
    lines = [[name, *(cell.get((name, column), "") for column in columns)] for name in names]
    return Sheet(f"{title}; in brackets the expected number", ["", *columns], lines)


def expected(folder: Path) -> dict[str, Any]:
    """Return expected.json of a reproduction: a row per quantity, and what else its program needs."""
    return json.loads((folder / "expected.json").read_text(encoding="utf-8"))


def judge(folder: Path, found: dict[str, Value], size: str) -> list[Row]:
    """Put every number beside its row of expected.json.

    Raises:
        KeyError: a number without a row, or a row without a number.
    """
    wanted = expected(folder)
    sigma = wanted["sigma"][size]
    keys = {row["key"] for section in wanted["sections"] for row in section["rows"]}
    if keys != set(found):
        raise KeyError(f"expected.json and the program disagree on {sorted(keys ^ set(found))}")
    return [
        _row(section["title"], row, found[row["key"]], sigma)
        for section in wanted["sections"]
        for row in section["rows"]
    ]


def _row(section: str, row: dict[str, Any], value: Value, sigma: float) -> Row:
    chance = sigma * value.error
    tolerance = row.get("abs", 0.0) + row.get("rel", 0.0) * abs(row["expected"]) + chance
    paper = row.get("paper")
    return Row(
        section=section,
        quantity=row["quantity"],
        column=row.get("column", ""),
        value=value,
        expected=row["expected"],
        tolerance=tolerance,
        paper=paper["says"] if paper else "",
        reproduces=abs(value.number - paper["value"]) <= paper["abs"] + chance if paper else None,
    )


def verdict(rows: list[Row]) -> str:
    """What came out, in two sentences."""
    stated = [row for row in rows if row.reproduces is not None]
    failed = [row.quantity for row in stated if not row.reproduces]
    return (
        f"{sum(row.holds for row in rows)} of {len(rows)} numbers are as expected. Of {len(stated)} that the "
        f"paper states, {len(stated) - len(failed)} reproduce; not: {'; '.join(failed) or 'none'}."
    )


def _text(number: float) -> str:
    if number == 0 or abs(number) < 1e-3:
        return f"{number:.1g}"
    decimals = 0 if number == round(number) else max(0, 3 - math.floor(math.log10(abs(number))))
    return f"{number:.{decimals}f}"


def _error(error: float) -> str:
    return f"{error:.1g}" if error < 1 else f"{error:.0f}"


def table(sheet: Sheet) -> Table:
    """One section for the terminal."""
    result = Table(title=sheet.title, title_justify="left", title_style="bold")
    for i, name in enumerate(sheet.header):
        result.add_column(name, justify="left" if i == 0 else "right")
    for line in sheet.lines:
        loud = "bold red" if any("VIOLATED" in cell for cell in line) else "yellow" if "NO" in line else ""
        result.add_row(*line, style=loud)
    return result


def markdown(sheet: Sheet) -> str:
    """One section as Markdown."""
    table = [sheet.header, ["---"] * len(sheet.header), *sheet.lines]
    lines = ["| " + " | ".join(line) + " |" for line in table]
    return "\n".join([f"### {sheet.title}", "", *lines, ""])


def readme(folder: Path, rows: list[Row], setup: str) -> str:
    """README.md with its tables replaced by those of this run."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    tail = rest.split(END)[1]
    body = "\n".join(markdown(sheet) for sheet in sheets(rows))
    return f"{head}{BEGIN}\n{setup}\n\n{body}\n{END}{tail}"


def write_whole(folder: Path, files: dict[str, str]) -> None:
    """Write all files, or none: each goes beside its place first, and moves there when all are written."""
    parts = {folder / name: folder / f".{name}.{secrets.token_hex(4)}.tmp" for name in files}
    try:
        for (place, part), text in zip(parts.items(), files.values(), strict=True):
            if place.is_dir():
                raise IsADirectoryError(f"{place} is a folder")
            part.write_text(text, encoding="utf-8")
        for place, part in parts.items():
            os.replace(part, place)
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
