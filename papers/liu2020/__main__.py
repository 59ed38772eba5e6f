"""Reproduce liu2020, Section VI; exit code 1 if a number of expected.json does not come out."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from papers.liu2020 import design, figure, monte_carlo, report, theorem4
from papers.liu2020.setting import FOLDER, Setting, Value


def compute(setting: Setting, console: Console) -> tuple[dict[str, Value], monte_carlo.Curve]:
    """All numbers by the keys of expected.json, and the curve of Fig. 2."""
    parts: dict[str, Callable[[], dict[str, Value]]] = {
        "decomposition": lambda: design.decomposition(setting, report.expected()["printed"]),
        "observability": lambda: design.observability(setting),
        "Theorem 4": lambda: theorem4.ratios(setting),
        "Kalman filter": lambda: monte_carlo.kalman(setting),
        "single-sensor attacks": lambda: monte_carlo.single_attacks(setting),
        "growing attacks": lambda: monte_carlo.growth(setting),
        "Theorem 3": lambda: monte_carlo.theorem3(setting),
    }
    found: dict[str, Value] = {}
    with console.status("simulating") as status:
        for name, part in parts.items():
            status.update(name)
            found |= part()
        status.update("Fig. 2")
        curve, values = monte_carlo.fig2(setting)
    return found | values, curve


def main(arguments: list[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m papers.liu2020", description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="a tenth of the samples; writes nothing without --out"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where README.md and fig2.svg go (default: beside the program)",
    )
    choice = parser.parse_args(arguments)
    folder: Path | None = choice.out or (None if choice.quick else FOLDER)
    if folder is not None and not folder.is_dir():
        parser.error(f"--out: expected a folder that exists, received {str(folder)!r}")

    begin = time.perf_counter()
    setting, console = (
        Setting("quick" if choice.quick else "full"),
        Console(width=None if sys.stdout.isatty() else 130),
    )
    found, curve = compute(setting, console)
    rows = report.judge(found, setting.size)
    setup = (
        f"Every simulated number comes from {setting.scale['runs']} runs of {setting.scale['steps']} samples "
        "and has its standard error after ±."
    )
    console.print(*map(report.table, report.sheets(rows)), setup, sep="\n")
    broken = [row for row in rows if not row.holds]
    console.print(_verdict(rows), f"{time.perf_counter() - begin:.0f} s")
    if broken:
        console.print(f"[bold red]{len(broken)} numbers are not as expected; nothing is written[/]")
        return 1
    if folder is not None:
        svg = figure.draw(curve, setting.config["fig2"]["attack"])
        report.write_whole(folder, {"README.md": report.readme(rows, setup), "fig2.svg": svg})
        console.print(f"wrote {folder / 'README.md'} and {folder / 'fig2.svg'}")
    return 0


def _verdict(rows: list[report.Row]) -> str:
    held = sum(row.holds for row in rows)
    stated = [row for row in rows if row.reproduces is not None]
    failed = [row.quantity for row in stated if not row.reproduces]
    return (
        f"{held} of {len(rows)} numbers are as expected. Of {len(stated)} that the paper states, "
        f"{len(stated) - len(failed)} reproduce; not: {'; '.join(failed) or 'none'}."
    )


if __name__ == "__main__":
    sys.exit(main())
