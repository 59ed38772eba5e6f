"""The four-bus grid, run as a user runs it."""

import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "four-bus"
METHODS = ("auto", "joint", "adaptive-joint")
BESIDE = METHODS[1:]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of results, and what was printed."""
    out = tmp_path_factory.mktemp("four-bus")
    words = [sys.executable, str(EXAMPLE / "run.py"), "--out", str(out)]
    process = subprocess.run(words, capture_output=True, text=True, encoding="utf-8", timeout=120)
    assert process.returncode == 0, process.stderr
    return out, process.stdout


def test_exactly_the_two_weak_sensors_are_named_by_every_method(done: tuple[Path, str]) -> None:
    assert done[1].count("2 of 5 sensors lie: weak 1 and weak 2.") == 3


def test_the_protected_sensors_are_reported_beside_methods_that_need_them(done: tuple[Path, str]) -> None:
    assert done[1].count("Beside it ProtectedKalman") == 2
    for method in BESIDE:
        page = (done[0] / f"{method}.html").read_text(encoding="utf-8")
        assert "Beside it ProtectedKalman" in page and 'id="data-beside"' in page


def test_the_bias_is_measured_with_the_deviation_that_is_stated(done: tuple[Path, str]) -> None:
    for method in METHODS:
        lying = pd.read_csv(done[0] / f"{method}.csv").iloc[260:]
        off = lying["attack.weak 2"] - 3.0
        assert abs(off.mean()) < 0.15
        assert 0.7 < off.std() / lying["attack_std.weak 2"].mean() < 1.4


def test_the_readme_has_the_errors_that_are_printed(done: tuple[Path, str]) -> None:
    readme = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    printed = dict(re.findall(r"^  (\w+): +([\d.]+)$", done[1], flags=re.MULTILINE))
    shown = dict(re.findall(r"^\| `(\w+)`[^|]*\| ([\d.]+) \|$", readme, flags=re.MULTILINE))
    assert len(printed) == 5
    assert printed == shown
