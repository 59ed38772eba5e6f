"""The power grid, run as a user runs it."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from securestate import Plant

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "ieee14"
LIAR, START, SIZE = "flow 4-5", 200, 5.0

#: Lines of the 14-bus case, from each bus to others.
LINES = [
    *("1-2", "1-5", "2-3", "2-4", "2-5", "3-4", "4-5", "4-7", "4-9", "5-6", "6-11", "6-12", "6-13"),
    *("7-8", "7-9", "9-10", "9-14", "10-11", "12-13", "13-14"),
]


def words(page: Path) -> str:
    """The text of a page without its tags."""
    text = re.sub(r"</?span>", "", page.read_text(encoding="utf-8"))
    return text.replace("\xa0", " ")


def call(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, words)], capture_output=True, text=True, encoding="utf-8", timeout=60
    )


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of results, and what was printed."""
    out = tmp_path_factory.mktemp("ieee14")
    process = call(EXAMPLE / "run.py", "--out", out)
    assert process.returncode == 0, process.stderr
    return out, process.stdout


@pytest.fixture(scope="module")
def estimates(done: tuple[Path, str]) -> pd.DataFrame:
    return pd.read_parquet(done[0] / "estimates.parquet")


def test_exactly_the_falsified_meter_is_named(done: tuple[Path, str]) -> None:
    assert f"1 of 57 sensors lies: {LIAR}." in done[1]


def test_no_honest_sensor_is_suspected_for_one_percent_of_the_time(estimates: pd.DataFrame) -> None:
    suspected = estimates.filter(like="suspected.").mean()
    assert len(suspected) == 57
    assert suspected.drop(f"suspected.{LIAR}").max() < 0.01


def test_the_lie_is_found_within_ten_seconds_and_measured_within_three_percent(
    estimates: pd.DataFrame,
) -> None:
    suspected = estimates[f"suspected.{LIAR}"].to_numpy(dtype=bool)
    assert not suspected[:START].any()
    assert suspected[START + 10 :].mean() > 0.98
    assert estimates[f"attack.{LIAR}"][suspected].median() == pytest.approx(SIZE, rel=0.03)


def test_the_angles_are_as_good_as_without_the_lie(done: tuple[Path, str], estimates: pd.DataFrame) -> None:
    truth = np.deg2rad(pd.read_csv(done[0] / "truth.csv"))
    off = estimates.filter(regex=r"^x\.").to_numpy() - truth.to_numpy()
    expected = estimates.filter(regex=r"^x_std\.").to_numpy()
    assert np.sqrt(np.mean((off / expected)[START:] ** 2)) == pytest.approx(1.0, abs=0.1)


def test_the_report_exists_and_names_the_meter(done: tuple[Path, str]) -> None:
    report = done[0] / "report.html"
    assert str(report) in done[1].splitlines()[-1]
    assert f"1 of 57 sensors lies: {LIAR}." in words(report)


def test_on_the_clean_record_nobody_is_named(done: tuple[Path, str]) -> None:
    words = ("-m", "securestate", "estimate", "--plant", EXAMPLE / "plant.toml")
    process = call(*words, "--data", done[0] / "clean.csv")
    assert process.returncode == 0, process.stderr
    assert re.search("No sensor (is suspected|lies persistently; there are isolated alarms)", process.stdout)


def test_the_sensors_are_both_ends_of_every_line_all_injections_and_three_angles() -> None:
    ends = [f"flow {line}" for line in LINES]
    ends += [f"flow {'-'.join(reversed(line.split('-')))}" for line in LINES]
    injections = [f"injection {bus}" for bus in range(1, 15)]
    angles = ["angle 3", "angle 4", "angle 10"]
    assert list(Plant.load(EXAMPLE / "plant.toml").sensor_names) == ends + injections + angles


def test_at_the_operating_point_the_plant_shows_the_power_flow_of_the_case() -> None:
    plant = Plant.load(EXAMPLE / "plant.toml")
    shown = dict(zip(plant.sensor_names, plant.offset, strict=True))
    assert [shown["flow 1-2"] + shown["flow 1-5"], shown["injection 1"]] == pytest.approx([219.0, 219.0])
    assert [shown["injection 2"], shown["injection 3"], shown["injection 4"]] == pytest.approx(
        [18.3, -94.2, -47.8]
    )


def test_the_plant_file_is_what_its_script_makes_of_the_model(tmp_path: Path) -> None:
    script = "import sys; sys.path.insert(0, sys.argv[1]); import prepare; prepare.plant().save(sys.argv[2])"
    process = call("-c", script, EXAMPLE, tmp_path / "plant.toml")
    assert process.returncode == 0, process.stderr
    assert Plant.load(tmp_path / "plant.toml") == Plant.load(EXAMPLE / "plant.toml")
