"""The command that judges a plant's model by a record."""

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import securestate as ss
from tests.cli.helpers import PLANT, Command, history, measurements
from tests.cli.test_identify import rows

TANK = ss.Plant(
    [[0.9]],
    [[4.0]],
    [ss.Sensor(name, C=[1.0], R=1.0, offset=20.0) for name in ("left", "middle", "right")],
    dt=60.0,
    name="tank",
)


@pytest.fixture
def tank(folder: Path) -> Path:
    """The folder with tank.toml, fits.csv, and differs.csv, in which one meter is off."""
    TANK.save(folder / "tank.toml")
    history(500).to_csv(folder / "fits.csv", index=False)
    frame = history(500)
    frame["left"] += 30
    frame.to_csv(folder / "differs.csv", index=False)
    return folder


def test_a_model_that_fits_ends_with_0_and_the_evidence_per_sensor(tank: Path, command: Command) -> None:
    before = {path.name for path in tank.iterdir()}
    done = command("judge", "tank.toml", "fits.csv")
    verdict = ss.judge(TANK, ss.read_history("fits.csv"))
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith(f"tank, 500 samples in 1 segment, one every 60 s:\n{verdict}\n\n")
    table = rows(done.out, "left", "middle", "right")
    assert [row[:2] for row in table] == [["left", "yes"], ["middle", "yes"], ["right", "yes"]]
    assert [row[6] for row in table] == [f"{100 * sensor.noise:.1f} %" for sensor in verdict.sensors]
    assert {path.name for path in tank.iterdir()} == before


def test_a_model_that_does_not_fit_ends_with_4_and_the_reason(tank: Path, command: Command) -> None:
    done = command("judge", "tank.toml", "differs.csv")
    assert (done.code, done.err) == (4, "")
    assert "The model is inadequate" in done.out
    assert "Without left the rest fits: more likely this sensor is wrong than the model." in done.out


def test_quiet_leaves_the_exit_code_only(tank: Path, command: Command) -> None:
    assert command("judge", "tank.toml", "fits.csv", "--quiet") == (0, "", "")
    assert command("judge", "tank.toml", "differs.csv", "--quiet") == (4, "", "")


def test_columns_that_the_plant_does_not_name_are_not_used(tank: Path, command: Command) -> None:
    said = command("judge", "tank.toml", "fits.csv").out
    frame = history(500)[["right", "time", "left", "middle"]]
    frame["note"] = "ok"
    frame.to_csv(tank / "more.csv", index=False)
    assert command("judge", "tank.toml", "more.csv").out == said


def test_runs_gaps_and_several_files_are_segments(tank: Path, command: Command) -> None:
    frame = history(500)
    frame["run"], frame["clock"] = frame.index // 250, frame["time"] % (60 * 250)
    frame = frame.drop(columns="time").drop(index=[50, *range(100, 150)])
    frame.to_csv(tank / "runs.csv", index=False)
    options = ("--segment-column", "run", "--time-column", "clock")
    done = command("judge", "tank.toml", "runs.csv", *options)
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith(
        "tank, 450 samples in 3 segments, one every 60 s, 0.2 % of the readings missing:"
    )
    two = command("judge", "tank.toml", "fits.csv", "fits.csv")
    assert two.out.startswith("tank, 1,000 samples in 2 segments, one every 60 s:")


def test_inputs_are_read_and_a_sensor_may_have_several_channels(tank: Path, command: Command) -> None:
    driven = ss.Plant(PLANT.A, PLANT.Q, PLANT.sensors, B=[[0.0], [0.0]], input_names=["valve"], dt=PLANT.dt)
    driven.save(tank / "driven.toml")
    frame = measurements(400)
    frame["valve"] = np.sin(np.arange(400))
    frame.to_csv(tank / "driven.csv", index=False)
    done = command("judge", "driven.toml", "driven.csv")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("driven.toml, 400 samples")
    assert len(rows(done.out, "flow 1", "flow 2", "flow 3", "level")) == 4


def test_what_identify_writes_can_be_judged(tank: Path, command: Command) -> None:
    command("identify", "fits.csv", "--order", "1", "-o", "learned.toml")
    history(400, seed=9).to_csv(tank / "new.csv", index=False)
    assert command("judge", "learned.toml", "new.csv").code == 0


def test_a_plant_that_varies_in_time_cannot_be_judged(tank: Path, command: Command) -> None:
    A = np.stack([np.eye(1), 0.5 * np.eye(1)])
    ss.Plant(A, [[1]], TANK.sensors, dt=60.0).save(tank / "varying.toml")
    done = command("judge", "varying.toml", "fits.csv")
    assert done.code in (2, 4)
    assert done.out == ""
    assert done.err.startswith("error: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tank.toml"], "Missing argument"),
        (["nothing.toml", "fits.csv"], "nothing.toml: "),
        (["tank.toml", "nothing.csv"], "nothing.csv: expected a readable file"),
        (["tank.toml", "honest.csv"], "honest.csv: expected a column for each of 'left', 'middle', 'right'"),
        (["tank.toml", "near.csv"], "(perhaps 'Left' for 'left')"),
        (
            ["tank.toml", "slow.csv"],
            "column 'time': expected the first time, 0.0, plus a multiple of 60 s",
        ),
        (["tank.toml", "fits.csv", "--segment-column", "runs"], "expected a column for each of 'runs'"),
    ],
)
def test_a_mistake_ends_with_2_and_its_name(
    tank: Path, command: Command, arguments: list[str], message: str
) -> None:
    frame = history(100)
    frame.rename(columns={"left": "Left"}).to_csv(tank / "near.csv", index=False)
    frame["time"] *= 1.1
    frame.to_csv(tank / "slow.csv", index=False)
    done = command("judge", *arguments)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: ")
    assert message in done.err


def test_help_tells_what_4_means_here(command: Command) -> None:
    assert "4 the model is inadequate" in " ".join(command("judge", "--help").out.split())


def test_no_warning_is_raised_where_readings_are_missing(tank: Path, command: Command) -> None:
    frame = history(500)
    frame.loc[100:130, "left"] = np.nan
    frame.to_csv(tank / "missing.csv", index=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = command("judge", "tank.toml", "missing.csv")
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize("damage", ["1e308", "-1e200"])
def test_a_reading_too_large_to_be_squared_is_an_error_that_says_where(
    tank: Path, command: Command, damage: str
) -> None:
    frame = pd.read_csv(tank / "fits.csv").astype({"middle": object})
    frame.loc[7, "middle"] = damage
    frame.to_csv(tank / "fits.csv", index=False)
    for words in (("judge", "tank.toml", "fits.csv"), ("identify", "fits.csv", "-o", "learned.toml")):
        done = command(*words)
        assert (done.code, done.out) == (2, "")
        assert "up to 1e+100" in done.err and "at [7, 1]" in done.err
