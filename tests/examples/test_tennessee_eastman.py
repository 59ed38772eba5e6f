"""The chemical plant, run as a user runs it."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from securestate import Plant, SparseFusion, judge
from securestate.measurements import read_measurements
from tests.test_readme import ROOT, assert_shown, blocks, commands, page

EXAMPLE = ROOT / "examples" / "tennessee-eastman"
PRESSURE, TEMPERATURE = "XMEAS 7 reactor pressure", "XMEAS 11 separator temperature"
HOUR = 20  # samples


def words(page: Path) -> str:
    """The text of a page without its tags."""
    text = re.sub(r"</?span>", "", page.read_text(encoding="utf-8"))
    return text.replace("\xa0", " ")


def call(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, words)], capture_output=True, text=True, encoding="utf-8", timeout=180
    )


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of results, and what was printed."""
    out = tmp_path_factory.mktemp("tennessee")
    process = call(EXAMPLE / "run.py", "--out", out)
    assert process.returncode == 0, process.stderr
    return out, process.stdout


@pytest.fixture(scope="module")
def estimates(done: tuple[Path, str]) -> pd.DataFrame:
    return pd.read_parquet(done[0] / "estimates.parquet")


def test_make_run_prints_what_the_readme_shows(done: tuple[Path, str]) -> None:
    shown = dict(
        pair for block in blocks("README.md") if block.language == "console" for pair in commands(block)
    )
    recipe = re.search(r"^run:.*\n\t@?\$\(PY\) (\S+)", page("Makefile"), re.MULTILINE)
    assert recipe
    assert ROOT / recipe[1] == EXAMPLE / "run.py"
    assert_shown("README.md, make run", shown["make run"], done[1])


VERIFIABLE = (1, 7, 11, 13, 16, 18, 19, 20, 21, 22)


def test_the_plant_that_is_learned_is_usable_and_ten_sensors_can_be_checked(done: tuple[Path, str]) -> None:
    assert "\nThe model is inadequate" not in done[1]
    plant = Plant.load(done[0] / "plant.toml")
    checked = [name for name, fine in zip(plant.channel_names, plant.verifiable, strict=True) if fine]
    assert checked == [f"XMEAS {i}" for i in VERIFIABLE]
    assert (plant.units[6], plant.dt) == ("kPa gauge", 180.0)


def test_the_plant_says_how_large_its_errors_are_on_a_record_that_is_new_to_it(
    done: tuple[Path, str],
) -> None:
    plant = Plant.load(done[0] / "plant.toml")
    clean = pd.read_csv(EXAMPLE / "data.csv")[list(plant.channel_names)]
    verdict = judge(plant, clean)
    assert verdict.grade == "good"
    assert 0.95 < verdict.residuals.size < 1.07
    assert set(verdict.verifiable) == {plant.sensor_names[i - 1] for i in VERIFIABLE}


def test_exactly_the_two_falsified_sensors_are_named(done: tuple[Path, str]) -> None:
    assert f"2 of 22 sensors lie: {PRESSURE} and {TEMPERATURE}." in done[1]


def test_no_honest_sensor_that_can_be_checked_is_suspected_for_one_percent_of_the_time(
    estimates: pd.DataFrame,
) -> None:
    """All are suspected more often than the stated 0.1 %: small errors of the learned plant add up."""
    suspected = estimates.filter(like="suspected.").mean()
    assert len(suspected) == 22
    honest = suspected.drop([f"suspected.{PRESSURE}", f"suspected.{TEMPERATURE}"])
    checked = [name for name in honest.index if int(name.split()[1]) in VERIFIABLE]
    assert len(checked) == 8 and honest[checked].max() < 0.01
    assert honest.mean() < 0.005 and honest.max() < 0.04


def test_sparse_fusion_suspects_no_honest_sensor_and_nobody_before_the_first_lie(
    done: tuple[Path, str],
) -> None:
    plant = Plant.load(done[0] / "plant.toml")
    run = SparseFusion(plant).run(read_measurements(done[0] / "attacked.csv", plant).y)
    liars = [plant.sensor_names.index(name) for name in (PRESSURE, TEMPERATURE)]
    assert np.delete(run.suspected, liars, axis=1).mean(axis=0).max() < 0.01
    assert not run.suspected[: 10 * HOUR].any()


def test_what_is_said_of_honest_sensors_is_that_their_alarms_are_faint(done: tuple[Path, str]) -> None:
    named = re.findall(r"^  (XMEAS .*?) (lies|lied|raised) ", done[1], re.MULTILINE)
    assert {name for name, how in named if how != "raised"} == {PRESSURE, TEMPERATURE}
    faint = sum(how == "raised" for _, how in named)
    text = " ".join(done[1].split())
    assert len(re.findall("too faint to say that it lies|more than chance explains", text)) == faint


@pytest.mark.parametrize(
    ("sensor", "start", "full", "delay", "size"),
    [(PRESSURE, 10, 10, 0.1, -15.0), (TEMPERATURE, 24, 30, 1.0, 1.0)],
)
def test_a_lie_is_found_in_time_and_measured_within_three_percent(
    estimates: pd.DataFrame, sensor: str, start: int, full: int, delay: float, size: float
) -> None:
    suspected = estimates[f"suspected.{sensor}"].to_numpy(dtype=bool)
    assert suspected[int((start + delay) * HOUR) :].mean() > 0.99
    channel = " ".join(sensor.split()[:2])
    assert estimates[f"attack.{channel}"].iloc[full * HOUR :].median() == pytest.approx(size, rel=0.03)


def test_the_report_exists_and_names_the_liars(done: tuple[Path, str]) -> None:
    report = done[0] / "report.html"
    assert str(report) in done[1].splitlines()[-1]
    assert all((done[0] / f"{page}.html").exists() for page in ("identification", "resilience"))
    assert f"2 of 22 sensors lie: {PRESSURE} and {TEMPERATURE}." in words(report)


def test_the_attacked_record_differs_from_the_clean_one_in_the_lies_only(done: tuple[Path, str]) -> None:
    clean, attacked = pd.read_csv(EXAMPLE / "data.csv"), pd.read_csv(done[0] / "attacked.csv")
    added = attacked - clean
    assert added.drop(columns=["XMEAS 7", "XMEAS 11"]).abs().to_numpy().max() == 0
    assert added["XMEAS 7"].round(5).tolist() == [0.0] * 200 + [-15.0] * 760
    assert added["XMEAS 11"].round(5).iloc[[480, 540, 600, 959]].tolist() == [0.0, 0.5, 1.0, 1.0]


def test_on_the_clean_record_nobody_is_named(done: tuple[Path, str]) -> None:
    words = (
        "-m",
        "securestate",
        "estimate",
        "--plant",
        done[0] / "plant.toml",
        "--data",
        EXAMPLE / "data.csv",
    )
    process = call(*words)
    assert process.returncode == 0, process.stderr
    assert re.search(
        "No sensor (is suspected|lies persistently; there are (isolated|faint) alarms)", process.stdout
    )


def test_the_plant_file_is_what_its_script_makes_of_the_identified_model(tmp_path: Path) -> None:
    script = "import sys; sys.path.insert(0, sys.argv[1]); import prepare; prepare.plant().save(sys.argv[2])"
    process = call("-c", script, EXAMPLE, tmp_path / "plant.toml")
    assert process.returncode == 0, process.stderr
    assert Plant.load(tmp_path / "plant.toml") == Plant.load(EXAMPLE / "plant.toml")
