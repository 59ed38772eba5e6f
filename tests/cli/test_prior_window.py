"""`securestate estimate --prior window`: records that start anywhere, and methods without a steady state."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import securestate as ss
from securestate.measurements import read_measurements
from tests.cli.helpers import PLANT, Command, measurements

WINDOW = ("estimate", "--plant", "plant.toml", "--data", "far.csv", "--prior", "window")


@pytest.fixture(autouse=True)
def far(folder: Path) -> None:
    """far.csv: the state is 80 off the operating point at first, and flow 2 adds 8 throughout."""
    frame, x = measurements(200), np.array([80.0, 40.0])
    for k in range(200):
        frame.iloc[k, 1:] += PLANT.scale * (PLANT.C @ x)
        x = PLANT.A @ x
    frame["flow 2"] += 8
    frame.to_csv(folder / "far.csv", index=False)


def test_a_record_that_starts_far_away_names_only_the_liar(command: Command) -> None:
    end = command(*WINDOW)
    assert (end.code, end.err) == (3, "")
    assert "1 of 4 sensors lies: flow 2." in end.out
    assert "Steps: OK 196, COLD_START 4." in end.out
    assert (
        "No prior: the first 4 samples were solved together; believed: flow 1, flow 3 and level; "
        "distrusted: flow 2." in end.out
    )
    assert "certified" not in end.out
    assert "flow 2 lies since 0.0 s (sample 0), still at the end: about +8" in end.out
    without = " ".join(command(*WINDOW[:-2], "--method", "sparse").out.split())
    assert "At times 3 more contradict the plant together." in without
    assert "the record may start far from the operating point; start with a window" in without


def test_the_files_hold_what_run_returns(command: Command, folder: Path) -> None:
    command(*WINDOW, "--method", "adaptive-joint", "--out", "states.parquet", "--report", "report.html")
    data, table = read_measurements(folder / "far.csv", PLANT), pd.read_parquet(folder / "states.parquet")
    expected = ss.AdaptiveJointFilter(PLANT).run(data.y, prior="window")
    np.testing.assert_array_equal(table[["x.x1", "x.x2"]], expected.x)
    np.testing.assert_array_equal(table["status"], expected.status)
    assert "No prior: the first 4 samples were solved together" in (folder / "report.html").read_text()


def test_a_method_without_a_steady_state_can_start(command: Command, folder: Path) -> None:
    sensors = [ss.Sensor(s.name, C=s.C, R=s.R, offset=s.offset, scale=s.scale) for s in PLANT.sensors]
    varying = ss.Plant([PLANT.A] * 200, PLANT.Q, sensors, dt=PLANT.dt)
    varying.save(folder / "plant.toml")
    refused = command(*WINDOW[:-2], "--method", "gate")
    assert refused.code == 4 and "--prior window" in refused.err
    end = command(*WINDOW, "--method", "gate")
    assert (end.code, end.err) == (3, "") and "1 of 4 sensors lies: flow 2." in end.out


def test_without_a_window_the_method_of_choice_blames_nobody_for_a_far_start_and_says_what_to_do(
    command: Command,
) -> None:
    end = command(*WINDOW[:-2])
    said = " ".join(end.out.split())
    assert end.code == 3 and "1 of 4 sensors lies: flow 2. At times 2 more contradict the plant" in said
    assert "the record may start far from the operating point; start with a window (--prior window)" in said


@pytest.mark.parametrize("method", ["kalman", "auto"])
def test_a_start_that_is_not_certified_is_said(command: Command, folder: Path, method: str) -> None:
    frame = pd.read_csv(folder / "far.csv").iloc[:6]
    frame[["time", "flow 1"]].to_csv(folder / "far.csv", index=False)
    files = ("--report", "report.html", "--findings", "findings.json")
    end = command(*WINDOW, "--method", method, "--allow-missing", *files)
    assert "This start is NOT certified: no other sensor checks flow 1, whatever it says." in end.out
    assert "ILL_CONDITIONED" in end.out
    assert "This start is NOT certified" in (folder / "report.html").read_text()
    assert any(
        "NOT certified" in note for note in json.loads((folder / "findings.json").read_text())["notes"]
    )


def test_a_plant_with_a_mode_that_nobody_sees_is_refused(command: Command, folder: Path) -> None:
    sensors = [ss.Sensor(s.name, C=np.c_[s.C, 0 * s.C[:, :1]], R=s.R) for s in PLANT.sensors]
    A = np.diag([0.9, 0.8, 0.5])
    ss.Plant(A, np.eye(3), sensors, dt=PLANT.dt).save(folder / "plant.toml")
    end = command(*WINDOW)
    assert end.code == 4 and "no sensor sees mode 0.5 (x3)" in end.err and "advice: give a prior" in end.err
