"""Make the CSV files of branches from an installed PYPOWER. Nothing else needs PYPOWER.

    python -m pip install pypower==5.1.21
    python prepare.py

A file has one row per branch in service, in the order of the case: the buses at its ends, its reactance in
per unit of 100 MVA and the ratio of its transformer (0: none).
"""

import csv
from importlib import import_module
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
CASES = ("case14", "case39", "case118", "case300")
HEADER = ("from", "to", "x", "tap")
COLUMNS = [0, 1, 3, 8]  # of PYPOWER's branch table: F_BUS, T_BUS, BR_X, TAP
IN_SERVICE = 10  # BR_STATUS

Row = tuple[int, int, float, float]


def load(case: str) -> Any:
    """Return the case as PYPOWER holds it, a dictionary of tables."""
    try:
        return getattr(import_module(f"pypower.{case}"), case)()
    except ImportError as error:
        raise SystemExit(
            f"PYPOWER is needed to make {case}.csv again (pip install pypower==5.1.21): {error}"
        ) from error


def branches(table: Any) -> list[Row]:
    """Return the rows of a CSV file from a branch table."""
    kept = table[table[:, IN_SERVICE] == 1][:, COLUMNS].tolist()
    return [(int(start), int(end), x, tap) for start, end, x, tap in kept]


def write(path: Path, rows: list[Row]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(rows)


if __name__ == "__main__":
    for case in CASES:
        write(HERE / f"{case}.csv", branches(load(case)["branch"]))
