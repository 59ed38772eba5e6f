"""What the command of every reproduction does: compute, judge, print, and write if every number holds."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from papers import _report as report


@dataclass(frozen=True)
class Result:
    """What a reproduction computed.

    Attributes:
        found: numbers by the keys of expected.json.
        setup: one sentence about where they come from.
        draw: makes the figures, SVG by file name.
    """

    found: dict[str, report.Value]
    setup: str
    draw: Callable[[], dict[str, str]]


def run(
    folder: Path, about: str | None, reproduce: Callable[[str, Console], Result], arguments: list[str] | None
) -> int:
    """Run a reproduction; returns its exit code.

    Args:
        folder: where its README.md and expected.json are.
        about: what `--help` says.
        reproduce: does the work, given the size ("full" or "quick") and a console for its progress.
        arguments: of the command line; None takes those of the process.
    """
    choice, place = _arguments(folder, about, arguments)
    begin = time.perf_counter()
    size = "quick" if choice.quick else "full"
    console = Console(width=None if sys.stdout.isatty() else 130)
    result = reproduce(size, console)
    rows = report.judge(folder, result.found, size)
    console.print(*map(report.table, report.sheets(rows)), result.setup, sep="\n")
    console.print(report.verdict(rows), f"{time.perf_counter() - begin:.0f} s")
    broken = sum(not row.holds for row in rows)
    if broken:
        console.print(f"[bold red]{broken} numbers are not as expected; nothing is written[/]")
        return 1
    if place is not None:
        files = {"README.md": report.readme(folder, rows, result.setup)} | result.draw()
        report.write_whole(place, files)
        console.print(f"wrote {', '.join(files)} to {place}")
    return 0


def _arguments(
    folder: Path, about: str | None, arguments: list[str] | None
) -> tuple[argparse.Namespace, Path | None]:
    """The options, and the folder to write to or None."""
    parser = argparse.ArgumentParser(prog=f"python -m papers.{folder.name}", description=about)
    parser.add_argument(
        "--quick", action="store_true", help="a tenth of the samples; writes nothing without --out"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where README.md and the figures go (default: beside the program)",
    )
    choice = parser.parse_args(arguments)
    place: Path | None = choice.out or (None if choice.quick else folder)
    if place is not None and not place.is_dir():
        parser.error(f"--out: expected a folder that exists, received {str(place)!r}")
    return choice, place
