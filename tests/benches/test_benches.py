"""The benchmarks run. Their times are not asserted: they depend on the machine."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def quick() -> str:
    """What `python -m benches --quick` prints."""
    command = [sys.executable, "-W", "error", "-m", "benches", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_quick_comparison_prints_a_finite_ratio(quick: str) -> None:
    rows = [
        re.split(r"\s{2,}", line.strip()) for line in quick.splitlines() if "–" in line and "min" not in line
    ]
    ratios = [float(row[5].replace(",", "")) for row in rows]
    assert len(ratios) >= 14
    assert all(0 < ratio < 1e7 for ratio in ratios)


def test_every_rival_takes_part(quick: str) -> None:
    for rival in ("filterpy", "statsmodels", "NumPy", "CVXPY + Clarabel", "Clarabel alone", "OSQP"):
        assert rival in quick
