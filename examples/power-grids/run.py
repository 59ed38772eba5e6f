"""How many lying sensors the grids survive, where they are weakest, and what would help."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from securestate import analyse

sys.path.insert(0, str(Path(__file__).resolve().parent))

from grids import REFERENCE, dc_grid

HEAD = "| grid | states, sensors | seen by at least | survives | weakest | to survive one more | seconds |"


def row(case: str) -> str:
    """One line of the table."""
    plant = dc_grid(case)
    start = time.perf_counter()
    found = analyse(plant)
    seconds = time.perf_counter() - start
    limit = found.limit
    seen = f"{limit.lower:.0f}" if limit.exact else f"{limit.lower:.0f} to {limit.upper:.0f}"
    weak = ", ".join(limit.weakest.sensors) if limit.weakest else "-"
    what = {"copy": "second sensors", "measure": "new angles", "protect": "protected", "add": "both kinds"}
    advice = (
        ", ".join(f"{what[option.kind]} {option.total}" for option in found.options) or "not found in time"
    )
    cells = [case, f"{plant.n}, {plant.m}", f"{seen} sensors", f"{found.max_attacked}", weak, advice]
    return f"| {' | '.join(cells)} | {seconds:.1f} |"


def main() -> None:
    """Print the table, a line as soon as it is known."""
    print(HEAD)
    print("|" + "---|" * (HEAD.count("|") - 1))
    for case in REFERENCE:
        print(row(case), flush=True)


if __name__ == "__main__":
    main()
